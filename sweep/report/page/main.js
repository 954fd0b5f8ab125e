// The page: reads what it holds, makes its views, and draws those that are seen when something changes.
import { addressOf, conditionOf, wantedOf } from "./url_state.js";
import {
  boxed,
  distributionsView,
  importanceView,
  keyMark,
  pairsView,
  rankedOf,
  rateView,
  stageView,
} from "./charts.js";
import { clipped, orderOf, pointOf, readTable } from "./data.js";
import { buttonOf, byId, element, lookOf, sheetOf, themeNow } from "./dom.js";
import { listView } from "./table.js";
import { mapView, worded } from "./map.js";
import { grouped, shortly } from "./numbers.js";
import { parallelView } from "./parallel.js";
import { playerOf } from "./player.js";
import { csvOf, give, offerPictures } from "./export.js";
import { narrow, showAll, sift, stateOf } from "./selection.js";

/** @import { Wanted } from "./url_state.js" */
/** @import { Column, Kind, Table } from "./data.js" */
/** @import { Look, Theme } from "./dom.js" */
/** @import { State } from "./selection.js" */

/**
 * What views may ask for and say.
 * @typedef {object} App
 * @property {Table} table
 * @property {State} state
 * @property {Wanted} wanted what the page's address asks for
 * @property {() => void} remember what is looked at, in the address
 * @property {{ column: Column, distance: number }[]} ranked parameters by how much they have to do with failure
 * @property {() => Theme} theme
 * @property {() => Look[]} looks of kinds
 * @property {(column: Column) => Uint32Array} order rows by value
 * @property {(number: number) => string} stream of a replay
 * @property {(row: number) => void} point at a row
 * @property {(row: number) => void} mark a row as chosen
 * @property {(row: number) => void} choose a row: mark it and open its replay
 * @property {(form: Form) => void} drawnAs says what the map is made of, so that the names of kinds show the same
 * @property {() => Form} form
 * @property {() => void} filtered says that filters have changed
 * @property {() => void} redraw everything that is seen
 * @property {() => Promise<void>} drawn draws everything, seen or not
 * @property {(text: string) => void} tell those who listen
 * @property {(row: number, columns: Column[]) => Node[]} words about a row
 * @property {(target: Element) => boolean} visible
 */

/** @typedef {"cells" | "marks"} Form */
/** @typedef {{ root: HTMLElement, draw: () => void | Promise<void>, point?: () => void, resized?: () => void }} View */

const SETTLED = 250; // ms after which the address says what is looked at

/** @returns {Promise<void>} */
async function begin() {
  const about = JSON.parse(byId("data").textContent ?? "{}");
  const table = await readTable(about);
  if (!table.rows) return;
  document.documentElement.classList.add("live");
  const watch = table.rows < 3 || table.columns.length < 2; // nothing to map: the replay is all there is
  document.documentElement.classList.toggle("watch", watch);
  const state = stateOf(table);
  /** @type {Map<Column, Uint32Array>} */
  const orders = new Map();
  const order = (/** @type {Column} */ column) => {
    const known = orders.get(column) ?? orderOf(column);
    orders.set(column, known);
    return known;
  };
  let theme = themeNow();
  let looks = about.kinds.map((/** @type {Kind} */ kind) => lookOf(kind, theme));
  /** @type {string[] | null} */
  let streams = null;
  /** @type {View[]} */
  const views = [];
  /** @type {Set<View>} */
  const waiting = new Set();
  let due = false;
  /** @type {Form} */
  let form = "cells";
  let everything = false; // is drawn, seen or not

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
  const wanted = wantedOf(table, location.hash);
  for (const [key, range] of wanted.ranges) narrow(state, key, range);
  for (const [key, value] of wanted.fixed) state.fixed.set(key, value);
  for (const kind of wanted.hidden) state.hidden.add(kind);
  sift(state);
  let noted = 0;
  const note = () => {
    const [x, y, colour] = ["map-x", "map-y", "map-colour"].map(
      (id) => /** @type {HTMLSelectElement} */ (byId(id)).value,
    );
    const point = state.chosen < 0 ? "" : pointOf(table, state.chosen);
    const now = { x, y, colour, point, time: player.time() };
    history.replaceState(null, "", addressOf(table, state, now));
  };
  /** @type {App} */
  const app = {
    table,
    state,
    wanted,
    remember: () => {
      clearTimeout(noted);
      noted = setTimeout(note, SETTLED);
    },
    ranked: rankedOf(table, order),
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
      sift(state);
      chips();
      app.redraw();
    },
    redraw: () => {
      for (const view of views) waiting.add(view);
      soon();
      app.remember();
    },
    drawn: async () => {
      everything = true;
      player.draw();
      await Promise.all(views.map((view) => view.draw()));
      everything = false;
    },
    tell: (text) => (byId("told").textContent = text),
    words: (row, columns) => wordsOf(app, row, columns),
    visible,
  };
  const chips = chipsOf(app);
  if (!watch)
    views.push(
      mapView(app),
      parallelView(app),
      stageView(app),
      importanceView(app),
      ...(about.adaptive ? [] : [rateView(app)]),
      distributionsView(app),
      pairsView(app),
      listView(app),
    );
  chips();
  views[0]?.draw();
  performance.mark("map");
  const player = playerOf(app);
  for (const view of views.slice(1)) waiting.add(view);
  soon();

  const again = () => {
    theme = themeNow();
    looks = about.kinds.map((/** @type {Kind} */ kind) => lookOf(kind, theme));
    for (const view of views) view.resized?.();
    chips();
    app.redraw();
    player.draw();
  };
  window.addEventListener("scroll", () => waiting.size && soon(), { passive: true });
  window.addEventListener("resize", again);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  linkTypical(app);
  offerTables(app);
  offerPictures(app);
  const row = wanted.point ? rowOf(table, wanted.point) : -1;
  if (row >= 0) {
    app.mark(row);
    player.openRow(row, wanted.time);
  }
}

/**
 * Buttons for the filters as a condition, and for the rows that they leave.
 * @param {App} app
 */
function offerTables(app) {
  const { table, state } = app;
  byId("copy").addEventListener("click", async () => {
    const condition = conditionOf(table, state);
    const text = condition ? `--where '${condition}'` : "";
    byId("copied").textContent = text || "no filter";
    await navigator.clipboard?.writeText(text).catch(() => {}); // where it is not allowed the words are there to be copied
  });
  byId("csv").addEventListener("click", () => give(new Blob([csvOf(app)], { type: "text/csv" }), "rows.csv"));
}

/**
 * The row whose id begins so, -1 for none.
 * @type {(table: Table, point: string) => number}
 */
function rowOf(table, point) {
  for (let row = 0; row < table.rows; row++) if (pointOf(table, row) === point) return row;
  return -1;
}

/**
 * Kinds as buttons that show and hide them, and filters that can be taken off; what draws them.
 * @type {(app: App) => () => void}
 */
function chipsOf(app) {
  const { table, state } = app;
  const root = byId("kinds");
  const buttons = table.about.kinds.map((kind, k) => {
    const swatch = element("canvas", { class: "swatch", "aria-hidden": "true" });
    const count = element("span", { class: "soft" });
    const toggle = () => {
      if (!state.hidden.delete(k)) state.hidden.add(k);
      app.filtered();
    };
    const told = { class: "chip", "aria-pressed": "true", title: kind.meaning };
    const button = buttonOf(told, toggle, swatch, clipped(kind.label), count);
    return { button, swatch, count };
  });
  root.replaceChildren(...buttons.map(({ button }) => button));
  const clear = byId("clear");
  clear.addEventListener("click", () => {
    showAll(state);
    app.filtered();
  });
  return () => {
    const { total } = table.about;
    const all = state.passing === table.rows;
    const counts = new Int32Array(buttons.length);
    for (let row = 0; row < table.rows; row++) counts[table.kind[row]] += state.mask[row];
    if (all) table.about.kinds.forEach((kind, k) => (counts[k] = kind.count)); // of a sample its rows are not all
    buttons.forEach(({ button, swatch, count }, k) => {
      button.setAttribute("aria-pressed", String(!state.hidden.has(k)));
      const sheet = sheetOf(swatch);
      const look = app.looks()[k];
      if (app.form() === "marks") keyMark(sheet, look, app.theme().paper);
      else boxed(sheet.pen, 0, 0, sheet.width, sheet.height, look, sheet.ratio);
      count.textContent = ` ${grouped(counts[k])}`;
    });
    const filters = [...state.ranges].map(([key, { low, high }]) => {
      const column = table.named.get(key);
      const names = column?.names?.filter((_, code) => code >= low && code <= high);
      const text = names ? names.join(", ") : `${shortly(low)} to ${shortly(high)}`;
      const off = () => {
        narrow(state, key, null);
        app.filtered();
      };
      const told = { class: "chip", title: "take this filter off" };
      return buttonOf(told, off, `${column?.label ?? key}: ${clipped(text)} ×`);
    });
    byId("filters").replaceChildren(...filters);
    const of = `${grouped(table.rows)} ${table.rows < total ? `drawn from ${grouped(total)} ` : ""}rollouts`;
    byId("passing").textContent = all ? `all ${grouped(total)} rollouts` : `${grouped(state.passing)} of ${of}`;
    clear.hidden = all && !state.ranges.size;
  };
}

/**
 * What is said of a row: outcome, the columns that are shown anyway, parameters, figures.
 * @type {(app: App, row: number, columns: Column[]) => Node[]}
 */
function wordsOf({ table }, row, columns) {
  const kind = table.about.kinds[table.kind[row]];
  const stage = table.stage[row] ? table.about.stages[table.stage[row] - 1] : "";
  const when = table.named.get("t_cause_s")?.values[row] ?? NaN;
  const head = [kind.outcome === "success" ? "success" : `${kind.outcome}: ${kind.label}`];
  if (stage) head.push(` in ${stage}`);
  if (Number.isFinite(when)) head.push(` at ${shortly(when)} s`);
  const shown = new Set([...columns, ...table.columns.filter((column) => column.axis).slice(0, 8)]);
  for (const column of table.columns) if (shown.size < 14 && !Number.isNaN(column.values[row])) shown.add(column);
  const lines = [...shown].flatMap((column) => [
    element("dt", {}, column.label),
    element("dd", {}, worded(column, column.values[row])),
  ]);
  const own = table.replayed.has(row) ? "click: its replay" : table.replayed.size ? "click: the nearest replay" : "";
  return [
    element("strong", {}, clipped(head.join(""))),
    element("dl", {}, ...lines),
    element("span", { class: "soft" }, `${pointOf(table, row)}${own ? `, ${own}` : ""}`),
  ];
}

/**
 * A button for the replay of each typical rollout that has one.
 * @param {App} app
 */
function linkTypical(app) {
  for (const article of document.querySelectorAll("[data-point]")) {
    const point = article.getAttribute("data-point") ?? "";
    const shown = app.table.about.replays.find((one) => one.point === point);
    if (!shown || shown.row < 0) continue;
    const open = () => {
      app.choose(shown.row);
      byId("replay").scrollIntoView({ behavior: "smooth", block: "center" });
    };
    article.querySelector("h3")?.append(" ", buttonOf({}, open, "▶ replay"));
  }
}

await begin();
