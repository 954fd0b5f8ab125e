// The page: decodes its data, makes its views, and redraws the visible ones when something changes.
import { formatAddress, formatCondition, parseAddress } from "./url_state.js";
import {
  drawKindBox,
  distributionsView,
  importanceView,
  drawKeyMark,
  pairsView,
  rankParameters,
  rateView,
  stageView,
} from "./charts.js";
import { curvesView } from "./curves.js";
import { estimateView } from "./estimate.js";
import { clipName, sortedRows, pointId, readTable } from "./data.js";
import { makeButton, byId, element, kindStyle, prepareCanvas, readTheme } from "./dom.js";
import { rowsTableView } from "./table.js";
import { startLeague } from "./league.js";
import { mapView, formatColumnValue } from "./map.js";
import { formatCount, formatShort } from "./numbers.js";
import { parallelView } from "./parallel.js";
import { makePlayer } from "./player.js";
import { formatCsv, download, offerPictures } from "./export.js";
import { setRange, clearFilters, applyFilters, makeState } from "./selection.js";
import { sidesView } from "./sides.js";

/** @import { ScaleKind } from "./axes.js" */
/** @import { AddressState } from "./url_state.js" */
/** @import { Column, Kind, Table } from "./data.js" */
/** @import { Ranked } from "./charts.js" */
/** @import { Look, Theme } from "./dom.js" */
/** @import { State } from "./selection.js" */

/**
 * Services that the page offers to its views.
 * @typedef {object} App
 * @property {Table} table
 * @property {State} state
 * @property {AddressState} wanted state in the page's address
 * @property {() => void} remember stores the present view in the address
 * @property {Ranked[]} ranked parameters by how strongly they are related to failure
 * @property {() => Theme} theme
 * @property {() => Look[]} looks of kinds
 * @property {(column: Column) => Uint32Array} order rows by value
 * @property {(number: number) => string} stream of a replay
 * @property {(row: number) => void} point at a row
 * @property {(row: number) => void} mark a row as chosen
 * @property {(row: number) => void} choose a row: mark it and open its replay
 * @property {(form: Form) => void} drawnAs reports the map's form, so that the legend of kinds shows the same
 * @property {() => Form} form
 * @property {() => void} filtered reports that filters have changed
 * @property {() => void} redraw draws all visible views
 * @property {(column: Column, scale: ScaleKind) => void} rescale gives the axes of a column another scale in all views
 * @property {() => Promise<void>} drawn draws all views, visible or not
 * @property {(text: string) => void} tell announces a text to screen readers
 * @property {(row: number, columns: Column[]) => Node[]} words describes a row
 * @property {(target: Element) => boolean} visible
 */

/** @typedef {"cells" | "marks"} Form */

/**
 * A part of the page that shows the rows.
 * @typedef {object} View
 * @property {HTMLElement} root
 * @property {() => void | Promise<void>} draw
 * @property {() => void} [point] shows which row is chosen, and which one is under the pointer
 * @property {() => void} [resized] is called before the view is drawn in another size
 * @property {() => void} [rescaled] is called before the view is drawn with another scale of an axis
 */

const ADDRESS_DELAY = 250; // ms after which the address is updated

/** @returns {Promise<void>} */
async function startPage() {
  const about = JSON.parse(byId("data").textContent ?? "{}");
  if (about.reload_s) setTimeout(() => location.reload(), 1000 * about.reload_s); // its address keeps the view
  const table = await readTable(about);
  if (!table.rows) return;
  document.documentElement.classList.add("live");
  const watch = table.rows < 3 || table.columns.length < 2; // nothing to map: only the replay is shown
  document.documentElement.classList.toggle("watch", watch);
  document.documentElement.classList.toggle("own-figure", table.alone.length > 0 || !!about.estimate);
  byId("replay").classList.toggle("empty", !about.replays.length); // before views take their widths
  const state = makeState(table);
  /** @type {Map<Column, Uint32Array>} */
  const orders = new Map();
  const order = (/** @type {Column} */ column) => {
    const known = orders.get(column) ?? sortedRows(column);
    orders.set(column, known);
    return known;
  };
  let theme = readTheme();
  let looks = about.kinds.map((/** @type {Kind} */ kind) => kindStyle(kind, theme));
  /** @type {string[] | null} */
  let streams = null;
  /** @type {View[]} */
  const views = [];
  /** @type {Set<View>} */
  const waiting = new Set();
  let due = false;
  /** @type {Form} */
  let form = "cells";
  let everything = false; // whether invisible views are drawn, too

  const visible = (/** @type {Element} */ target) => {
    if (everything) return true;
    const { top, bottom, height } = target.getBoundingClientRect();
    return height > 0 && bottom > -100 && top < window.innerHeight + 100;
  };
  const paint = () => {
    due = false;
    for (const view of [...waiting]) {
      if (!visible(view.root)) continue;
      waiting.delete(view);
      view.draw();
    }
  };
  const soon = () => {
    if (!due) requestAnimationFrame(paint);
    due = true;
  };
  const wanted = parseAddress(table, location.hash);
  for (const [key, range] of wanted.ranges) setRange(state, key, range);
  for (const [key, value] of wanted.fixed) state.fixed.set(key, value);
  for (const kind of wanted.hidden) state.hidden.add(kind);
  for (const column of table.columns) column.scale = wanted.scales.get(column.key) ?? column.scale;
  state.lines = wanted.lines;
  applyFilters(state);
  let noted = 0;
  const note = () => {
    const [x, y, colour] = ["map-x", "map-y", "map-colour"].map(
      (id) => /** @type {HTMLSelectElement} */ (byId(id)).value,
    );
    const point = state.chosen < 0 ? "" : pointId(table, state.chosen);
    const now = { x, y, colour, point, time: player.time(), span: player.span() };
    history.replaceState(null, "", formatAddress(table, state, now));
  };
  /** @type {App} */
  const app = {
    table,
    state,
    wanted,
    remember: () => {
      clearTimeout(noted);
      noted = setTimeout(note, ADDRESS_DELAY);
    },
    ranked: rankParameters(table, order),
    theme: () => theme,
    looks: () => looks,
    order,
    stream: (number) => (streams ??= (byId("streams").textContent ?? "").trim().split("\n"))[number],
    point: (row) => {
      if (row === state.cursor) return;
      state.cursor = row;
      for (const view of views) if (visible(view.root)) view.point?.();
    },
    mark: (row) => {
      state.chosen = row;
      for (const view of views) if (visible(view.root)) view.point?.();
      app.remember();
    },
    choose: (row) => {
      app.mark(row);
      player.openRow(row);
      if (matchMedia("(max-width: 60rem)").matches)
        byId("replay").scrollIntoView({ behavior: "smooth", block: "start" });
    },
    drawnAs: (now) => {
      if (now === form) return;
      form = now;
      chips();
    },
    form: () => form,
    filtered: () => {
      applyFilters(state);
      chips();
      app.redraw();
    },
    redraw: () => {
      for (const view of views) waiting.add(view);
      soon();
      app.remember();
    },
    rescale: (column, scale) => {
      column.scale = scale;
      for (const view of views) view.rescaled?.();
      app.redraw();
    },
    drawn: async () => {
      everything = true;
      player.draw();
      await Promise.all(views.map((view) => view.draw()));
      everything = false;
    },
    tell: (text) => (byId("told").textContent = text),
    words: (row, columns) => describeRow(app, row, columns),
    visible,
  };
  const chips = addFilterButtons(app);
  if (!watch)
    views.push(
      ...(table.alone.length ? [curvesView(app)] : []),
      ...(about.estimate ? [estimateView(app)] : []),
      mapView(app),
      ...(table.sides ? [sidesView(app, table.sides)] : []),
      parallelView(app),
      stageView(app),
      importanceView(app),
      ...(about.adaptive ? [] : [rateView(app)]),
      distributionsView(app),
      pairsView(app),
      rowsTableView(app),
    );
  chips();
  if (!watch) {
    describeWhatMatters(app);
    fitFirstFigure();
  }
  views[0]?.draw();
  performance.mark("map");
  const player = makePlayer(app);
  for (const view of views.slice(1)) waiting.add(view);
  soon();

  const again = () => {
    theme = readTheme();
    looks = about.kinds.map((/** @type {Kind} */ kind) => kindStyle(kind, theme));
    if (!watch) fitFirstFigure();
    for (const view of views) view.resized?.();
    chips();
    app.redraw();
    player.draw();
  };
  window.addEventListener("scroll", () => waiting.size && soon(), { passive: true });
  window.addEventListener("resize", again);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  linkRepresentative(app);
  addExportButtons(app);
  offerPictures(app);
  const row = wanted.point ? findRow(table, wanted.point) : -1;
  const [first] = about.replays;
  if (row < 0 && about.open && first.row >= 0) app.mark(first.row); // the page was made to show this row
  if (row >= 0) {
    app.mark(row);
    player.openRow(row, wanted.time);
  }
}

/**
 * Say in a sentence which parameters matter most, above the map of draws.
 * @param {App} app
 */
function describeWhatMatters({ table, ranked }) {
  const { about } = table;
  const drawn = table.columns.filter((column) => column.axis && column.drawn).length;
  const told = ranked.filter(({ distance }) => distance > 0);
  if (drawn < 2 || about.region || about.start.length || about.adaptive || !told.length) return;
  const words = told.slice(0, 2).map(({ column, distance, significant }) => {
    const chance = significant || !about.independent ? "" : ", which may be chance";
    return `${column.label} (${distance.toFixed(2)} of 1${chance})`;
  });
  const text = `Successes and failures differ most in ${words.join(", then in ")}.`;
  document.querySelector("#map h2")?.after(element("p", { class: "answer" }, text));
}

/** Tell the style sheet where the first figure begins, so that it fits on the first screen. */
function fitFirstFigure() {
  const first = document.querySelector("#curves, #estimate-chart") ?? byId("map-base");
  const top = first.getBoundingClientRect().top + scrollY;
  document.documentElement.style.setProperty("--first-top", `${Math.round(top)}px`);
}

/**
 * Add buttons that copy the filters as a condition and save the filtered rows.
 * @param {App} app
 */
function addExportButtons(app) {
  const { table, state } = app;
  byId("copy").addEventListener("click", async () => {
    const condition = formatCondition(table, state);
    const text = condition ? `--where '${condition}'` : "";
    const left = [...state.ranges.keys()].filter((key) => table.named.get(key)?.derived);
    byId("copied").textContent =
      (text || "no filter") + (left.length ? ` (without ${left.join(", ")}: only this page has it)` : "");
    await navigator.clipboard?.writeText(text).catch(() => {}); // without permission the user can copy the text by hand
  });
  byId("csv").addEventListener("click", () => download(new Blob([formatCsv(app)], { type: "text/csv" }), "rows.csv"));
}

/**
 * Find the row whose point id begins with `point`, -1 for none.
 * @type {(table: Table, point: string) => number}
 */
function findRow(table, point) {
  for (let row = 0; row < table.rows; row++) if (pointId(table, row) === point) return row;
  return -1;
}

/**
 * Add buttons that show and hide kinds, and buttons that remove filters. Returns the function that redraws them.
 * @type {(app: App) => () => void}
 */
function addFilterButtons(app) {
  const { table, state } = app;
  const root = byId("kinds");
  const buttons = table.about.kinds.map((kind, k) => {
    const swatch = element("canvas", { class: "swatch", "aria-hidden": "true" });
    const count = element("span", { class: "soft" });
    const toggle = () => {
      if (!state.hidden.delete(k)) state.hidden.add(k);
      app.filtered();
    };
    const attributes = { class: "chip", "aria-pressed": "true", title: kind.meaning };
    const button = makeButton(attributes, toggle, swatch, clipName(kind.label), count);
    return { button, swatch, count };
  });
  root.replaceChildren(...buttons.map(({ button }) => button));
  const clear = byId("clear");
  clear.addEventListener("click", () => {
    clearFilters(state);
    app.filtered();
  });
  return () => {
    const { total } = table.about;
    const all = state.passing === table.rows;
    const counts = new Int32Array(buttons.length);
    for (let row = 0; row < table.rows; row++) counts[table.kind[row]] += state.mask[row];
    if (all) table.about.kinds.forEach((kind, k) => (counts[k] = kind.count)); // the page may hold only a sample of the rows
    buttons.forEach(({ button, swatch, count }, k) => {
      button.setAttribute("aria-pressed", String(!state.hidden.has(k)));
      const sheet = prepareCanvas(swatch);
      const look = app.looks()[k];
      if (app.form() === "marks") drawKeyMark(sheet, look, app.theme().paper);
      else drawKindBox(sheet.pen, 0, 0, sheet.width, sheet.height, look, sheet.ratio);
      count.textContent = ` ${formatCount(counts[k])}`;
    });
    const filters = [...state.ranges].map(([key, { low, high }]) => {
      const column = table.named.get(key);
      const names = column?.names?.filter((_, code) => code >= low && code <= high);
      const text = names ? names.join(", ") : `${formatShort(low)} to ${formatShort(high)}`;
      const off = () => {
        setRange(state, key, null);
        app.filtered();
      };
      const attributes = { class: "chip", title: "take this filter off" };
      return makeButton(attributes, off, `${column?.label ?? key}: ${clipName(text)} ×`);
    });
    byId("filters").replaceChildren(...filters);
    const of = `${formatCount(table.rows)} ${table.rows < total ? `drawn from ${formatCount(total)} ` : ""}rollouts`;
    byId("passing").textContent = all ? `all ${formatCount(total)} rollouts` : `${formatCount(state.passing)} of ${of}`;
    clear.hidden = all && !state.ranges.size;
  };
}

/**
 * Describe a row: outcome, the columns on display, parameters, metrics.
 * @type {(app: App, row: number, columns: Column[]) => Node[]}
 */
function describeRow({ table }, row, columns) {
  const kind = table.about.kinds[table.kind[row]];
  const stage = table.stage[row] ? table.about.stages[table.stage[row] - 1] : "";
  const when = table.named.get("t_cause_s")?.values[row] ?? NaN;
  const head = [kind.outcome === "success" ? "success" : `${kind.outcome}: ${kind.label}`];
  if (stage) head.push(` in ${stage}`);
  if (Number.isFinite(when)) head.push(` at ${formatShort(when)} s`);
  const shown = new Set([...columns, ...table.columns.filter((column) => column.axis).slice(0, 8)]);
  for (const column of table.columns) if (shown.size < 14 && !Number.isNaN(column.values[row])) shown.add(column);
  const sides = (table.sides?.kinds ?? []).flatMap((kinds, side) => [
    element("dt", {}, table.sides?.names[side] ?? ""),
    element("dd", {}, clipName(table.sides?.styles[kinds[row]].label ?? "")),
  ]);
  const lines = [...shown].flatMap((column) => [
    element("dt", {}, column.label),
    element("dd", {}, formatColumnValue(column, column.values[row])),
  ]);
  const own = table.replayed.has(row) ? "click: its replay" : table.replayed.size ? "click: the nearest replay" : "";
  return [
    element("strong", {}, clipName(head.join(""))),
    element("dl", {}, ...sides, ...lines),
    element("span", { class: "soft" }, `${pointId(table, row)}${own ? `, ${own}` : ""}`),
  ];
}

/**
 * Add a button for the replay of each representative rollout.
 * @param {App} app
 */
function linkRepresentative(app) {
  for (const article of document.querySelectorAll("[data-point]")) {
    const point = article.getAttribute("data-point") ?? "";
    const shown = app.table.about.replays.find((one) => one.point === point);
    if (!shown || shown.row < 0) continue;
    const open = () => {
      app.choose(shown.row);
      byId("replay").scrollIntoView({ behavior: "smooth", block: "center" });
    };
    article.querySelector("h3")?.append(" ", makeButton({}, open, "▶ replay"));
  }
}

await (document.getElementById("league") ? startLeague() : startPage());
