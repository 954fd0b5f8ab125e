// Outcomes along each parameter that varies alone: their shares at each value, by cause, with the rate's interval.
import { axisTitle, drawFrame, makeScale, wholeCells } from "./axes.js";
import { drawKindBox } from "./charts.js";
import { sortedValues } from "./data.js";
import { CLICK_REACH, byId, drawLine, element, cssColour, placeTip, pointerPosition, prepareCanvas } from "./dom.js";
import { formatColumnValue } from "./map.js";
import { cellEdges, clamp, formatCount, lastIndexBelow } from "./numbers.js";
import { setRange } from "./selection.js";

/** @import { Scale } from "./axes.js" */
/** @import { AloneAxis, Table } from "./data.js" */
/** @import { App, View } from "./main.js" */

const [MOST_VALUES, VALUE_BINS] = [60, 20]; // values that get a bar each; bars of more values
const CURVE_MARGIN = { left: 48, right: 10, top: 10, bottom: 48 };
const SHARE_MARKS = [0, 0.25, 0.5, 0.75, 1].map((value) => ({ value, text: `${100 * value} %` }));

/**
 * A panel: the bars of one parameter.
 * @typedef {object} CurvePanel
 * @property {AloneAxis} axis
 * @property {HTMLCanvasElement} canvas
 * @property {Float64Array} values at the middle of the bars
 * @property {Int32Array} bars of the rows of the axis
 */

/**
 * Bars of the outcomes at each value of each parameter; drag to select a range, click one for a replay.
 * @type {(app: App) => View}
 */
export function curvesView(app) {
  const { table, state } = app;
  const root = byId("curves");
  const tip = byId("curves-tip");
  const { kinds } = table.about;
  const upwards = ["success", "failure", "invalid"].flatMap((outcome) =>
    kinds.flatMap((kind, k) => (kind.outcome === outcome ? [k] : [])),
  );
  const panels = table.alone.map(makePanel).sort((a, b) => successRange(table, b) - successRange(table, a));
  root.replaceChildren(...panels.map(({ canvas }) => canvas));

  /** @type {(axis: AloneAxis) => CurvePanel} */
  function makePanel(axis) {
    const { column, rows } = axis;
    const label = `${column.title}: shares of outcomes at each value; drag to choose a range, click for a replay`;
    const canvas = element("canvas", { role: "img", "aria-label": label });
    const values = barValues(axis);
    const edges = cellEdges(values);
    const bars = Int32Array.from(rows, (row) => clamp(lastIndexBelow(edges, column.values[row]), 0, values.length - 1));
    /** @type {CurvePanel} */
    const panel = { axis, canvas, values, bars };
    /** @type {number | null} */
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = pointerPosition(event, canvas)[0];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = pointerPosition(event, canvas);
      if (from === null) return describeBar(panel, x, y);
      if (Math.abs(x - from) < CLICK_REACH) return;
      tip.hidden = true;
      const { scale, shareAt } = layPanel(panel);
      setRange(state, column.key, wholeCells(scale, shareAt(from), shareAt(x)));
      app.filtered();
    });
    canvas.addEventListener("pointerup", (event) => {
      const [x, y] = pointerPosition(event, canvas);
      if (from !== null && Math.abs(x - from) < CLICK_REACH) chooseIn(panel, x, y);
      from = null;
    });
    canvas.addEventListener("pointercancel", () => (from = null));
    canvas.addEventListener("pointerleave", () => (tip.hidden = true));
    return panel;
  }

  /** @param {CurvePanel} panel */
  function layPanel({ axis, canvas, values }) {
    const { left, right, top, bottom } = CURVE_MARGIN;
    const [width, height] = [canvas.clientWidth - left - right, canvas.clientHeight - top - bottom];
    const scale = makeScale(axis.column, values, width / 44);
    const shareAt = (/** @type {number} */ x) => clamp((x - left) / width, 0, 1);
    return { box: { left, top, width, height }, scale, shareAt };
  }

  const countPassing = (/** @type {CurvePanel} */ panel) => countKinds(table, panel, (row) => state.mask[row]);

  /**
   * The bar and kind at a place; no kind above and below the bars.
   * @type {(panel: CurvePanel, x: number, y: number) => { bar: number, kind: number, counts: Float64Array } | null}
   */
  function partAt(panel, x, y) {
    const { box, scale, shareAt } = layPanel(panel);
    const edges = /** @type {Float64Array} */ (scale.edges);
    if (x < box.left || x > box.left + box.width || y > box.top + box.height) return null;
    const bar = clamp(lastIndexBelow(edges, shareAt(x)), 0, panel.values.length - 1);
    const counts = countPassing(panel)[bar];
    const total = counts.reduce((a, b) => a + b, 0);
    let left = (1 - (y - box.top) / box.height) * total;
    const kind = upwards.find((one) => (left -= counts[one]) <= 0 && counts[one] > 0) ?? -1;
    return total ? { bar, kind, counts } : null;
  }

  /** @type {(panel: CurvePanel, x: number, y: number) => void} */
  function describeBar(panel, x, y) {
    const part = partAt(panel, x, y);
    tip.hidden = !part;
    if (!part) return;
    const { column } = panel.axis;
    const lines = upwards
      .filter((kind) => part.counts[kind])
      .flatMap((kind) => [element("dt", {}, kinds[kind].label), element("dd", {}, formatCount(part.counts[kind]))]);
    const at = `${column.label} ${formatColumnValue(column, panel.values[part.bar])}`;
    tip.replaceChildren(element("strong", {}, at), element("dl", {}, ...lines));
    placeTip(tip, panel.canvas.offsetLeft + x, panel.canvas.offsetTop + y);
  }

  /**
   * Open the replay of a rollout of the bar's part, of one that has its own if possible.
   * @type {(panel: CurvePanel, x: number, y: number) => void}
   */
  function chooseIn(panel, x, y) {
    const part = partAt(panel, x, y);
    if (!part) return;
    const within = panel.axis.rows.filter(
      (row, k) => panel.bars[k] === part.bar && state.mask[row] && (part.kind < 0 || table.kind[row] === part.kind),
    );
    const row = within.find((one) => table.replayed.has(one)) ?? within[0];
    if (row !== undefined) app.choose(row);
  }

  /** @param {CurvePanel} panel */
  function drawPanel(panel) {
    const { axis, canvas, values } = panel;
    const sheet = prepareCanvas(canvas);
    const { pen, ratio } = sheet;
    const { ink, paper, accent } = app.theme();
    const { box, scale } = layPanel(panel);
    const bottom = box.top + box.height;
    const edges = /** @type {Float64Array} */ (scale.edges);
    const looks = app.looks();
    countPassing(panel).forEach((counts, bar) => {
      const total = counts.reduce((a, b) => a + b, 0);
      const left = box.left + edges[bar] * box.width + 0.5;
      const width = Math.max(1, (edges[bar + 1] - edges[bar]) * box.width - 1);
      let base = bottom;
      for (const kind of upwards) {
        const size = (counts[kind] / total) * box.height;
        if (!counts[kind]) continue;
        base -= size;
        drawKindBox(pen, left, base, width, Math.max(1, size), looks[kind], ratio);
      }
    });
    if (state.passing === table.rows)
      axis.at.forEach((value, k) => drawWhisker(pen, box, scale, value, axis.low[k], axis.high[k], paper, ink));
    const along = (/** @type {number} */ value) => box.left + clamp(scale.to(value), 0, 1) * box.width;
    if (axis.nominal !== null && axis.nominal >= values[0] && axis.nominal <= values[values.length - 1]) {
      pen.strokeStyle = ink;
      pen.lineWidth = 1.5;
      pen.setLineDash([2, 3]);
      drawLine(pen, along(axis.nominal), box.top, along(axis.nominal), bottom);
      pen.setLineDash([]);
    }
    const range = state.ranges.get(axis.column.key);
    if (range) {
      pen.strokeStyle = accent;
      pen.lineWidth = 2;
      pen.strokeRect(along(range.low), box.top, along(range.high) - along(range.low), box.height);
    }
    const share = { to: Number, ticks: SHARE_MARKS };
    drawFrame(sheet, app.theme(), box, { scale, title: axisTitle(axis.column, scale) }, { scale: share, title: "" });
  }

  return { root, draw: () => panels.forEach(drawPanel) };
}

/**
 * Draw the interval of a success rate over its bar.
 * @param {CanvasRenderingContext2D} pen
 * @param {{ left: number, top: number, width: number, height: number }} box
 * @param {Scale} scale
 * @param {number} value
 * @param {number} low
 * @param {number} high
 * @param {[number, number, number]} paper
 * @param {string} ink
 */
function drawWhisker(pen, { left, top, width, height }, scale, value, low, high, paper, ink) {
  const x = left + scale.to(value) * width;
  const [upper, lower] = [top + (1 - high) * height, top + (1 - low) * height];
  for (const [colour, size] of /** @type {[string, number][]} */ ([
    [cssColour(paper), 4],
    [ink, 1.5],
  ])) {
    pen.strokeStyle = colour;
    pen.lineWidth = size;
    drawLine(pen, x, upper, x, lower);
    drawLine(pen, x - 3, upper, x + 3, upper);
    drawLine(pen, x - 3, lower, x + 3, lower);
  }
}

/**
 * Values in the middle of the bars: each value of a grid, or bins of equal width.
 * @type {(axis: AloneAxis) => Float64Array}
 */
function barValues({ column, rows }) {
  const values = sortedValues({ ...column, values: Float64Array.from(rows, (row) => column.values[row]) });
  if (values.length <= MOST_VALUES) return Float64Array.from(values);
  const [low, high] = [values[0], values[values.length - 1]];
  return Float64Array.from({ length: VALUE_BINS }, (_, k) => low + ((k + 0.5) / VALUE_BINS) * (high - low));
}

/**
 * Number of rollouts by bar and kind, each counted with its weight.
 * @type {(table: Table, panel: CurvePanel, weight: (row: number) => number) => Float64Array[]}
 */
function countKinds(table, { axis, values, bars }, weight) {
  const counts = Array.from(values, () => new Float64Array(table.about.kinds.length));
  axis.rows.forEach((row, k) => (counts[bars[k]][table.kind[row]] += weight(row)));
  return counts;
}

/**
 * Difference between the largest and the smallest share of successes at the values of a parameter.
 * @type {(table: Table, panel: CurvePanel) => number}
 */
function successRange(table, panel) {
  const { kinds } = table.about;
  const sum = (/** @type {Float64Array} */ counts, /** @type {string[]} */ ...outcomes) =>
    counts.reduce((total, count, kind) => total + (outcomes.includes(kinds[kind].outcome) ? count : 0), 0);
  const shares = countKinds(table, panel, () => 1)
    .map((counts) => sum(counts, "success") / sum(counts, "success", "failure"))
    .filter((share) => !Number.isNaN(share));
  return shares.length ? Math.max(...shares) - Math.min(...shares) : 0;
}
