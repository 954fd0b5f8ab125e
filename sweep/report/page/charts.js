// Smaller charts of the rows that pass the filters: causes, importance of parameters, distributions, rates, pairs.
import { axisMapping, axisTitle, drawFrame, makeScale, equalCellScale, scaleNote, wholeCells } from "./axes.js";
import { binRows, clipName, clippedRange, distributionDistance, gridValues, kolmogorovSmirnov } from "./data.js";
import {
  CLICK_REACH,
  byId,
  cssColour,
  element,
  fillSelect,
  columnOptions,
  pointerPosition,
  prepareCanvas,
  drawLine,
} from "./dom.js";
import { fillKindCell, fillMark, isVectorPen } from "./marks.js";
import { clamp, formatCount, packRgb, parseColour, formatShort, wilsonInterval } from "./numbers.js";
import { makeGlyph, paintKind, makePixels, drawStamp, makeStamp } from "./raster.js";
import { setRange } from "./selection.js";

/** @import { Along, Scale } from "./axes.js" */
/** @import { Column, Table } from "./data.js" */
/** @import { Look, Rgb, Sheet } from "./dom.js" */
/** @import { App, View } from "./main.js" */

const [BINS, LISTED] = [32, 60]; // bins of continuous values; most values of a grid that get a bin each
const SHOWN_DISTRIBUTIONS = 8; // distributions shown before the user asks for more
const MARK_RADIUS = 5; // CSS pixels, radius of a mark beside the name of its kind
export const LEGEND_SYMBOL = 13; // CSS pixels of a symbol's width and height
const PAIRED_COLUMNS = 6; // columns of the matrix of pairs

/**
 * Make a function of a row: 0 for a success, 1 for a failure, 2 for an invalid or filtered row.
 * @type {(app: App) => (row: number) => number}
 */
function makeOutcomeSide({ table, state }) {
  const side = outcomeSideOfAll(table);
  return (row) => (state.mask[row] ? side(row) : 2);
}

/**
 * Like `makeOutcomeSide`, regardless of filters.
 * @type {(table: Table) => (row: number) => number}
 */
function outcomeSideOfAll(table) {
  const sides = Uint8Array.from(table.about.kinds, ({ outcome }) => ({ success: 0, failure: 1, invalid: 2 })[outcome]);
  return (row) => sides[table.kind[row]];
}

/**
 * Chart of causes by the stage in which they occurred.
 * @type {(app: App) => View}
 */
export function stageView(app) {
  const { table, state } = app;
  const canvas = /** @type {HTMLCanvasElement} */ (byId("stages"));
  const { kinds } = table.about;
  const stages = table.about.stages
    .map((name, k) => ({ name: clipName(name), code: k + 1 }))
    .filter(({ code }) => table.stage.some((one, row) => one === code && kinds[table.kind[row]].outcome !== "success"));
  canvas.style.height = `${40 + 26 * Math.max(1, stages.length)}px`;
  const draw = () => {
    const { pen, width, ratio } = prepareCanvas(canvas);
    const { ink, soft } = app.theme();
    const looks = app.looks();
    const counts = stages.map(() => kinds.map(() => 0));
    const line = new Map(stages.map(({ code }, k) => [code, k]));
    for (let row = 0; row < table.rows; row++) {
      const at = line.get(table.stage[row]);
      if (state.mask[row] && at !== undefined) counts[at][table.kind[row]]++;
    }
    const totals = counts.map((one) => one.reduce((a, b) => a + b, 0));
    const most = Math.max(1, ...totals);
    const left = Math.min(140, 0.34 * width);
    pen.textBaseline = "middle";
    stages.forEach(({ name }, k) => {
      const y = 8 + 26 * k;
      pen.fillStyle = ink;
      pen.textAlign = "right";
      pen.fillText(name, left - 8, y + 9, left - 10);
      let x = left;
      counts[k].forEach((count, kind) => {
        const size = (count / most) * (width - left - 50);
        if (!count) return;
        drawKindBox(pen, x, y, Math.max(1, size), 18, looks[kind], ratio);
        x += size;
      });
      pen.fillStyle = soft;
      pen.textAlign = "left";
      pen.fillText(formatCount(totals[k]), x + 6, y + 9);
    });
    if (!stages.length) {
      pen.fillStyle = soft;
      pen.fillText("No rollout fails.", 4, 16);
    }
  };
  return { root: canvas, draw };
}

/**
 * Draw a box in the colour of a kind with its glyph, like a cell of the map.
 * @param {CanvasRenderingContext2D} pen
 * @param {number} x
 * @param {number} y
 * @param {number} width
 * @param {number} height
 * @param {Look} look
 * @param {number} ratio
 */
export function drawKindBox(pen, x, y, width, height, look, ratio) {
  if (isVectorPen(pen)) return fillKindCell(pen, x, y, width, height, look, width >= 12);
  const [wide, high] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  const pixels = makePixels(wide, high);
  const glyph = width >= 12 ? makeGlyph(look, ratio) : null;
  paintKind(pixels, { left: 0, top: 0, right: wide, bottom: high }, look, glyph, -1, ratio);
  pen.putImageData(pixels.image, Math.round(x * ratio), Math.round(y * ratio));
}

/**
 * Draw the symbol of a kind in a legend: a mark where the map has marks, else a box like a cell.
 * @type {(app: App, pen: CanvasRenderingContext2D, x: number, y: number, kind: number, ratio: number) => void}
 */
export function drawLegendSymbol(app, pen, x, y, kind, ratio) {
  const look = app.looks()[kind];
  if (app.form() !== "marks") return drawKindBox(pen, x, y, LEGEND_SYMBOL, LEGEND_SYMBOL, look, ratio);
  const middle = LEGEND_SYMBOL / 2;
  if (isVectorPen(pen)) return fillMark(pen, look.shape, x + middle, y + middle, MARK_RADIUS, look.mark, 1);
  const size = Math.round(LEGEND_SYMBOL * ratio);
  const pixels = makePixels(size, size);
  pixels.colours.fill(packRgb(...app.theme().paper));
  drawStamp(pixels, makeStamp(look.shape, MARK_RADIUS * ratio), size / 2, size / 2, look.mark, 1, -2);
  pen.putImageData(pixels.image, Math.round(x * ratio), Math.round(y * ratio));
}

/**
 * Draw a mark of a kind, like those of the map.
 * @type {(sheet: Sheet, look: Look, paper: Rgb) => void}
 */
export function drawKeyMark(sheet, look, paper) {
  const { pen, width, height, ratio } = sheet;
  const pixels = makePixels(Math.round(width * ratio), Math.round(height * ratio));
  pixels.colours.fill(packRgb(...paper));
  drawStamp(pixels, makeStamp(look.shape, MARK_RADIUS * ratio), pixels.width / 2, pixels.height / 2, look.mark, 1, -2);
  pen.putImageData(pixels.image, 0, 0);
}

/**
 * Chart of how strongly each parameter is related to failure.
 * @type {(app: App) => View}
 */
export function importanceView(app) {
  const { table } = app;
  const canvas = /** @type {HTMLCanvasElement} */ (byId("importance"));
  const columns = table.columns.filter((column) => column.axis);
  canvas.style.height = `${44 + 24 * Math.min(16, Math.max(1, columns.length))}px`;
  const draw = () => {
    const { pen, width } = prepareCanvas(canvas);
    const { ink, soft, line, accent } = app.theme();
    const side = makeOutcomeSide(app);
    const { effects, independent } = table.about; // rows of a refined map lie at the boundary, so its Sobol indices are used
    const found = columns.map((column) => {
      const one = distributionDistance(column, app.order, side);
      const distance = effects ? (effects[column.key] ?? 0) : one.distance;
      return { column, ...one, distance, significant: one.significant || !independent };
    });
    found.sort((a, b) => b.distance - a.distance);
    const left = Math.min(190, 0.42 * width);
    const room = width - left - 48;
    pen.textBaseline = "middle";
    found.slice(0, 16).forEach(({ column, distance, significant }, k) => {
      const y = 6 + 24 * k;
      pen.textAlign = "right";
      pen.fillStyle = ink;
      pen.fillText(column.label, left - 8, y + 8, left - 10);
      pen.fillStyle = significant ? accent : line;
      pen.fillRect(left, y, Math.max(1, distance * room), 16);
      pen.textAlign = "left";
      pen.fillStyle = soft;
      pen.fillText(distance.toFixed(2), left + distance * room + 6, y + 8);
    });
    pen.strokeStyle = line;
    drawLine(pen, left - 0.5, 2, left - 0.5, 6 + 24 * Math.min(16, found.length));
    const one = found[0];
    byId("importance-note").textContent =
      one?.counts[0] && one.counts[1]
        ? `Among ${formatCount(one.counts[0])} successes and ${formatCount(one.counts[1])} failures.`
        : "Needs both successes and failures among the rollouts shown.";
  };
  return { root: canvas, draw };
}

/**
 * Chart of the success rate of all rollouts up to a value, or up to a number of rollouts.
 * @type {(app: App) => View}
 */
export function rateView(app) {
  const { table } = app;
  const canvas = /** @type {HTMLCanvasElement} */ (byId("rates"));
  const select = /** @type {HTMLSelectElement} */ (byId("rates-by"));
  const numbers = table.columns.filter((column) => !column.names);
  // a grid is run point by point in the order of its axes, so its first rollouts are no sample of it
  const grid = table.columns.some((column) => column.axis && !column.drawn);
  const sorted = app.ranked.map(({ column }) => column).find(({ names }) => !names) ?? numbers[0];
  const planned = /** @type {[string, string][]} */ (grid && sorted ? [] : [["", "number of rollouts"]]);
  fillSelect(select, [...planned, ...columnOptions(numbers)], planned.length ? "" : sorted.key);
  select.addEventListener("change", () => app.redraw());
  const counting = Float64Array.from({ length: table.rows }, (_, row) => row);
  const draw = () => {
    const sheet = prepareCanvas(canvas);
    const { pen, width, height } = sheet;
    const side = makeOutcomeSide(app);
    const column = table.named.get(select.value);
    const order = column ? app.order(column) : counting;
    const box = { left: 64, top: 10, width: width - 78, height: height - 58 };
    const steps = Math.max(1, Math.floor(order.length / 240));
    let [good, all] = [0, 0];
    /** @type {{ at: number, rate: number, ends: [number, number] }[]} */
    const curve = [];
    for (let k = 0; k < order.length; k++) {
      const of = side(order[k]);
      if (of < 2) all++;
      if (of === 0) good++;
      const tied = column && k + 1 < order.length && column.values[order[k + 1]] === column.values[order[k]];
      if (of < 2 && !tied && (k % steps === 0 || k + 1 === order.length || all < 60))
        curve.push({ at: column ? column.values[order[k]] : all, rate: good / all, ends: wilsonInterval(good, all) });
    }
    const [low, high] = column ? [column.low, column.high] : [0, Math.max(1, all)];
    /** @type {Column} */
    const shown = { ...(column ?? numbers[0] ?? table.columns[0]), names: null, low, high };
    if (!column) shown.scale = "linear";
    const x = makeScale(shown, null, width / 80);
    const marks = [0, 0.25, 0.5, 0.75, 1].map((value) => ({ value, text: `${100 * value} %` }));
    const y = { to: Number, ticks: marks };
    const spot = (/** @type {number} */ at, /** @type {number} */ rate) =>
      /** @type {const} */ ([box.left + x.to(at) * box.width, box.top + (1 - rate) * box.height]);
    if (table.about.sure) {
      pen.fillStyle = cssColour(parseColour(table.about.colours.success), 0.3);
      pen.beginPath();
      curve.forEach(({ at, ends }) => pen.lineTo(...spot(at, ends[1])));
      [...curve].reverse().forEach(({ at, ends }) => pen.lineTo(...spot(at, ends[0])));
      pen.fill();
    }
    pen.strokeStyle = app.theme().accent;
    pen.lineWidth = 2;
    pen.beginPath();
    curve.forEach(({ at, rate }) => pen.lineTo(...spot(at, rate)));
    pen.stroke();
    const title = column ? `${axisTitle(column, x)}, up to` : "rollouts, in the order of the draws";
    drawFrame(sheet, app.theme(), box, { scale: x, title }, { scale: y, title: "rate of success" });
  };
  return { root: canvas, draw };
}

/**
 * Histograms of columns, failures beside successes.
 * @type {(app: App) => View}
 */
export function distributionsView(app) {
  const { table, state } = app;
  const root = byId("distributions-live");
  const side = makeOutcomeSide(app);
  const columns = table.columns.filter((column) => !column.names && column.high > column.low);
  const ranks = new Map(
    columns.map((column) => [column, kolmogorovSmirnov(app.order(column), column.values, side).distance]),
  );
  columns.sort(
    (a, b) =>
      Number(b.axis && b.drawn) - Number(a.axis && a.drawn) ||
      Number(b.axis) - Number(a.axis) ||
      (ranks.get(b) ?? 0) - (ranks.get(a) ?? 0),
  );
  const [few] = table.about.kinds
    .filter(({ outcome }) => outcome !== "invalid")
    .map(({ count }) => count)
    .sort((a, b) => a - b);
  const many = clamp(Math.round(1.6 * Math.sqrt(few ?? 1)), 8, BINS);
  const more = byId("distributions-more");
  let shown = SHOWN_DISTRIBUTIONS;
  /** @typedef {Pick<Scale, "to" | "back" | "edges">} Across */
  /** @type {{ canvas: HTMLCanvasElement, column: Column, ends: number[], many: number, bins: Uint8Array, across: Across }[]} */
  let panels = [];
  const fill = () => {
    panels = columns.slice(0, shown).map((column) => {
      const label = `${column.title}: distributions of successes and failures; drag to choose a range`;
      const canvas = element("canvas", { class: "small", role: "img", "aria-label": label });
      const grid = gridValues(column) ?? []; // one bin for each value, all of equal width
      const listed = grid.length > 1 && grid.length <= LISTED;
      const [low, high] = listed ? [column.low, column.high] : clippedRange(app.order(column), column);
      const { to, back } = axisMapping({ ...column, low, high });
      const whole = (/** @type {number} */ share) => (share <= 0 ? column.low : share >= 1 ? column.high : back(share));
      const across = listed ? equalCellScale(Float64Array.from(grid), 1) : { to, back: whole, edges: null };
      const number = listed ? grid.length : many;
      brushed(canvas, column, across);
      return { canvas, column, ends: [low, high], many: number, bins: binRows(column, number, across.to), across };
    });
    root.replaceChildren(...panels.map(({ canvas }) => canvas));
    more.hidden = shown >= columns.length;
  };
  more.addEventListener("click", () => {
    shown = columns.length;
    fill();
    app.redraw();
  });
  fill();

  /** @type {(canvas: HTMLCanvasElement, column: Column, across: Across) => void} */
  function brushed(canvas, column, across) {
    /** @type {number | null} */
    let from = null;
    const shareAt = (/** @type {number} */ x) => clamp((x - 10) / (canvas.clientWidth - 20), 0, 1);
    canvas.addEventListener("pointerdown", (event) => {
      from = pointerPosition(event, canvas)[0];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x] = pointerPosition(event, canvas);
      if (from === null || Math.abs(x - from) < CLICK_REACH) return;
      setRange(state, column.key, wholeCells(across, shareAt(from), shareAt(x)));
      app.filtered();
    });
    canvas.addEventListener("pointerup", (event) => {
      if (from !== null && Math.abs(pointerPosition(event, canvas)[0] - from) < CLICK_REACH) {
        setRange(state, column.key, null);
        app.filtered();
      }
      from = null;
    });
  }

  const draw = () => {
    const sides = makeOutcomeSide(app);
    const { ink, soft, line, accent } = app.theme();
    const colours = [table.about.colours.success, ink]; // no cause's colour, as failures are of all causes
    for (const { canvas, column, ends, many, bins, across } of panels) {
      const { pen, width, height } = prepareCanvas(canvas);
      const counts = [new Float64Array(many), new Float64Array(many)];
      for (let row = 0; row < table.rows; row++) {
        const of = sides(row);
        if (of < 2 && bins[row] < many) counts[of][bins[row]]++;
      }
      const totals = counts.map((count) => count.reduce((a, b) => a + b, 0));
      const most = Math.max(...counts.map((count, k) => Math.max(...count) / (totals[k] || 1))) || 1;
      const [left, bottom, wide, high] = [10, height - 34, width - 20, height - 46];
      counts.forEach((count, k) => {
        if (!totals[k]) return;
        pen.beginPath();
        pen.moveTo(left, bottom);
        count.forEach((number, bin) => {
          const y = bottom - (number / totals[k] / most) * high;
          pen.lineTo(left + (bin / many) * wide, y);
          pen.lineTo(left + ((bin + 1) / many) * wide, y);
        });
        pen.lineTo(left + wide, bottom);
        pen.globalAlpha = k ? 0.16 : 0.3;
        pen.fillStyle = colours[k];
        pen.fill();
        pen.globalAlpha = 1;
        pen.strokeStyle = colours[k];
        pen.lineWidth = 1.4;
        pen.setLineDash(k ? [4, 2] : []);
        pen.stroke();
      });
      pen.setLineDash([]);
      pen.strokeStyle = line;
      drawLine(pen, left, bottom + 0.5, left + wide, bottom + 0.5);
      const place = (/** @type {number} */ value) => left + clamp(across.to(value), 0, 1) * wide;
      const limit = column.diverges ? 0 : column.limit;
      if (limit !== null && limit >= column.low && limit <= column.high) {
        pen.strokeStyle = ink;
        pen.setLineDash([3, 3]);
        drawLine(pen, place(limit), 8, place(limit), bottom);
        pen.setLineDash([]);
      }
      const range = state.ranges.get(column.key);
      if (range) {
        pen.fillStyle = accent;
        pen.globalAlpha = 0.2;
        pen.fillRect(place(range.low), 6, Math.max(2, place(range.high) - place(range.low)), bottom - 6);
        pen.globalAlpha = 1;
      }
      pen.fillStyle = soft;
      pen.textBaseline = "top";
      pen.textAlign = "left";
      pen.fillText(`${ends[0] > column.low ? "≤ " : ""}${formatShort(ends[0])}`, left, bottom + 4);
      pen.textAlign = "right";
      pen.fillText(`${ends[1] < column.high ? "≥ " : ""}${formatShort(ends[1])}`, left + wide, bottom + 4);
      pen.fillStyle = ink;
      pen.textAlign = "center";
      const note = across.edges ? "" : scaleNote(column);
      pen.fillText(axisTitle(column, { note }), width / 2, bottom + 18, width - 4);
    }
  };
  return { root, draw, rescaled: fill };
}

/**
 * Matrix of scatter plots of the most important columns, drawn on demand.
 * @type {(app: App) => View}
 */
export function pairsView(app) {
  const { table, state } = app;
  const canvas = /** @type {HTMLCanvasElement} */ (byId("pairs"));
  const details = /** @type {HTMLDetailsElement} */ (byId("pairs-box"));
  details.addEventListener("toggle", () => app.redraw());
  const columns = [
    ...app.ranked.map(({ column }) => column).filter(({ names }) => !names),
    ...table.columns.filter(({ key }) => key === "margin"),
  ].slice(0, PAIRED_COLUMNS);
  const draw = () => {
    if (!details.open || columns.length < 2) return;
    canvas.style.height = `${canvas.clientWidth}px`;
    const { pen, width, ratio } = prepareCanvas(canvas);
    const { ink, soft, line, paper } = app.theme();
    const looks = app.looks();
    const cell = (width - 8) / columns.length;
    const size = Math.round((cell - 10) * ratio);
    const radius = clamp(30 / Math.sqrt(table.rows), 0.9, 3) * ratio;
    const stamps = looks.map((look) => makeStamp(look.shape, radius));
    const alongs = columns.map((column) => axisMapping(column));
    columns.forEach((y, j) =>
      columns.forEach((x, i) => {
        const [left, top] = [4 + i * cell, 4 + j * cell];
        if (i === j) {
          pen.fillStyle = ink;
          pen.textAlign = "center";
          pen.textBaseline = "middle";
          pen.fillText(x.title, left + cell / 2 - 5, top + cell / 2 - 5, cell - 14);
          pen.fillStyle = soft;
          pen.fillText(
            `${formatShort(x.low)} to ${formatShort(x.high)}`,
            left + cell / 2 - 5,
            top + cell / 2 + 12,
            cell - 14,
          );
          return;
        }
        if (i > j) return;
        const pixels = makePixels(size, size);
        pixels.colours.fill(packRgb(...paper));
        for (let row = 0; row < table.rows; row++) {
          if (!state.mask[row]) continue;
          const [u, v] = [x.values[row], y.values[row]];
          if (Number.isNaN(u) || Number.isNaN(v)) continue;
          const at = (/** @type {Along} */ column, /** @type {number} */ value) => 0.03 + 0.94 * column.to(value);
          const kind = table.kind[row];
          const [across, down] = [at(alongs[i], u) * size, (1 - at(alongs[j], v)) * size];
          drawStamp(pixels, stamps[kind], across, down, looks[kind].mark, 0.6, -2);
        }
        pen.putImageData(pixels.image, Math.round(left * ratio), Math.round(top * ratio));
        pen.strokeStyle = line;
        pen.strokeRect(left - 0.5, top - 0.5, size / ratio + 1, size / ratio + 1);
      }),
    );
  };
  return { root: canvas, draw };
}

/** @typedef {{ column: Column, distance: number, significant: boolean }} Ranked a parameter and its relation to failure */

/**
 * Rank parameters by how strongly they are related to failure, over all rows.
 * @type {(table: Table, order: (column: Column) => Uint32Array) => Ranked[]}
 */
export function rankParameters(table, order) {
  const side = outcomeSideOfAll(table);
  return table.columns
    .filter((column) => column.axis)
    .map((column) => ({ column, ...distributionDistance(column, order, side) }))
    .sort((a, b) => b.distance - a.distance);
}
