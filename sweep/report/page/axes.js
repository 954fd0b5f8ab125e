// Axes of charts: from values to pixels and back, ticks and titles.
import { bent, clamp, edgesOf, placeIn, shortly, ticks, unbent } from "./numbers.js";

/** @import { Column } from "./data.js" */
/** @import { Sheet, Theme } from "./dom.js" */
/** @typedef {{ value: number, text: string }} Mark along an axis */
/** @typedef {{ scale: Scale, title: string }} Titled */

/**
 * A way from values to a share of an axis, 0 to 1, and back.
 * @typedef {object} Scale
 * @property {(value: number) => number} to
 * @property {(share: number) => number} back
 * @property {Mark[]} ticks
 * @property {Float64Array | null} edges of cells, as shares, where the axis has cells
 * @property {Float64Array | null} cells their values
 */

const UNEVEN = 3; // gaps between cells that differ more have cells of equal width

/**
 * The scale of a column: of names or of cells where it has `cells`, else even between its ends with some room.
 * @param {Column} column
 * @param {Float64Array | null} cells sorted values
 * @param {number} room ticks that have room
 * @returns {Scale}
 */
export function scaleOf(column, cells, room) {
  if (column.names) {
    const count = column.names.length;
    const values = Float64Array.from({ length: count }, (_, k) => k);
    const every = Math.max(1, Math.ceil(count / room));
    const marks = column.names.map((text, value) => ({ value, text })).filter(({ value }) => value % every === 0);
    const edges = Float64Array.from({ length: count + 1 }, (_, k) => k / count); // also below the first name, whose code is 0
    return { ...even(-0.5, count - 0.5, marks, null), edges, cells: values };
  }
  if (!cells && column.diverges) return bentScale(column, room);
  if (!cells) {
    const margin = 0.03 * (column.high - column.low) || 0.5;
    const low = column.low >= 0 ? Math.max(0, column.low - margin) : column.low - margin;
    return even(low, column.high + margin, numbered(low, column.high + margin, room), null);
  }
  const gaps = Array.from(cells.subarray(1), (value, k) => value - cells[k]);
  if (!gaps.length || Math.max(...gaps) < UNEVEN * Math.min(...gaps)) {
    const edges = edgesOf(cells);
    const [low, high] = [edges[0], edges[edges.length - 1]];
    const few = cells.length <= room / 1.5;
    const marks = few ? Array.from(cells, (value) => ({ value, text: shortly(value) })) : numbered(low, high, room);
    return even(low, high, marks, cells);
  }
  return uneven(cells, room);
}

/** @type {(low: number, high: number, room: number) => Mark[]} */
function numbered(low, high, room) {
  return ticks(low, high, room).map((value) => ({ value, text: shortly(value) }));
}

/** @type {(low: number, high: number, marks: Mark[], cells: Float64Array | null) => Scale} */
function even(low, high, marks, cells) {
  const size = high - low || 1;
  const to = (/** @type {number} */ value) => (value - low) / size;
  const edges = cells ? edgesOf(cells).map((edge) => clamp(to(edge), 0, 1)) : null;
  return { to, back: (share) => low + share * size, ticks: marks, edges, cells };
}

/**
 * A scale that shows how near zero values are, however far a few of them are from it.
 * @type {(column: Column, room: number) => Scale}
 */
function bentScale({ low, high }, room) {
  const [first, last] = [bent(low) - 0.1, bent(high) + 0.1];
  const to = (/** @type {number} */ value) => (bent(value) - first) / (last - first);
  const marks = bentTicks(low, high, room).map((value) => ({ value, text: shortly(value) }));
  return { to, back: (share) => unbent(first + share * (last - first)), ticks: marks, edges: null, cells: null };
}

/**
 * Zero, and powers of ten on both sides of it.
 * @type {(low: number, high: number, room: number) => number[]}
 */
function bentTicks(low, high, room) {
  const size = Math.max(-low, high);
  const powers = Array.from({ length: Math.max(1, Math.ceil(Math.log10(size / 0.1)) + 1) }, (_, k) => 10 ** (k - 1));
  const every = Math.max(1, Math.ceil((2 * powers.length) / room));
  return [0, ...powers.filter((_, k) => k % every === 0).flatMap((power) => [-power, power])];
}

/** @typedef {"inverted" | "log"} Way of an axis that is not upright, or not even */
/** @typedef {Pick<Scale, "to" | "back">} Along */

/**
 * The way from values of a column to shares of an axis from its lowest to its highest, and back: even, or bent about zero
 * where the column diverges.
 * @type {(column: Column, way?: Way) => Along}
 */
export function alongOf({ low, high, diverges }, way) {
  if (!(high > low)) return { to: () => 0.5, back: () => low };
  const [on, off] = way === "log" ? [Math.log, Math.exp] : diverges ? [bent, unbent] : [Number, Number];
  const [first, last] = way === "inverted" ? [high, low] : [low, high];
  const [start, size] = [on(first), on(last) - on(first)];
  return {
    to: (value) => (on(value) - start) / size,
    back: (share) => (share <= 0 ? first : share >= 1 ? last : off(start + share * size)), // the ends to the last bit
  };
}

/**
 * Round values, or names, along such an axis.
 * @type {(column: Column, way: Way | undefined, room: number) => number[]}
 */
export function ticksAlong({ names, low, high, diverges }, way, room) {
  if (names) {
    const every = Math.ceil(names.length / (3 * room)); // words lie flat
    return names.map((_, k) => k).filter((k) => k > low && k < high && k % every === 0);
  }
  if (way === "log") {
    const [first, last] = [Math.ceil(Math.log10(low)), Math.floor(Math.log10(high))];
    const every = Math.max(1, Math.ceil((last - first + 1) / room));
    return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => 10 ** (first + k)).filter(
      (_, k) => k % every === 0,
    );
  }
  return diverges ? bentTicks(low, high, room) : ticks(low, high, room);
}

/**
 * The range between two places of an axis, as shares of it: of a grid's sorted values as many as it comes nearest to.
 * @type {(along: Along, grid: number[] | null, a: number, b: number) => { low: number, high: number }}
 */
export function snapped({ to, back }, grid, a, b) {
  if (!grid) return whole({ edges: null, back }, a, b);
  const places = grid.map(to).sort((p, q) => p - q);
  const edges = Float64Array.of(0, ...places.slice(1).map((place, k) => (places[k] + place) / 2), 1);
  return whole({ edges, back }, a, b);
}

/**
 * The range between two places of an axis, as shares of it; of cells as many as it touches, whole.
 * @type {(scale: Pick<Scale, "edges" | "back">, a: number, b: number) => { low: number, high: number }}
 */
export function whole({ edges, back }, a, b) {
  const [low, high] = [Math.min(a, b), Math.max(a, b)];
  if (!edges) return { low: back(low), high: back(high) };
  const below = edges.findLast((edge) => edge <= low + 1e-9) ?? 0;
  const above = edges.find((edge) => edge >= high - 1e-9) ?? 1;
  return { low: back(below), high: back(above) };
}

/**
 * Cells of equal width, whose values are not evenly spaced.
 * @type {(cells: Float64Array, room: number) => Scale}
 */
export function uneven(cells, room) {
  const count = cells.length;
  const to = (/** @type {number} */ value) => {
    const k = clamp(placeIn(cells, value), 0, count - 2);
    return (clamp(k + (value - cells[k]) / (cells[k + 1] - cells[k]), -0.5, count - 0.5) + 0.5) / count;
  };
  const back = (/** @type {number} */ share) => {
    const place = share * count - 0.5;
    const k = clamp(Math.floor(place), 0, count - 2);
    return cells[k] + (place - k) * (cells[k + 1] - cells[k]);
  };
  const every = Math.max(1, Math.ceil(count / room));
  const marks = Array.from(cells, (value) => ({ value, text: shortly(value) })).filter((_, k) => k % every === 0);
  const edges = Float64Array.from({ length: count + 1 }, (_, k) => k / count);
  return { to, back, ticks: marks, edges, cells };
}

/** @typedef {{ left: number, top: number, width: number, height: number }} Box */

/**
 * The frame of a chart: ticks with numbers along the lower and the left side, and the axes' titles.
 * @type {(sheet: Sheet, theme: Theme, box: Box, x: Titled, y: Titled) => void}
 */
export function drawFrame({ pen }, theme, box, x, y) {
  const { left, top, width, height } = box;
  const bottom = top + height;
  pen.strokeStyle = theme.line;
  pen.lineWidth = 1;
  pen.strokeRect(left - 0.5, top - 0.5, width + 1, height + 1);
  pen.fillStyle = theme.soft;
  pen.textBaseline = "top";
  pen.textAlign = "center";
  pen.beginPath();
  for (const { value, text } of x.scale.ticks) {
    const at = left + x.scale.to(value) * width;
    if (at < left - 1 || at > left + width + 1) continue;
    pen.moveTo(at, bottom);
    pen.lineTo(at, bottom + 4);
    pen.fillText(text, clamp(at, left + 4, left + width - 4), bottom + 7, width);
  }
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const { value, text } of y.scale.ticks) {
    const at = bottom - y.scale.to(value) * height;
    if (at < top - 1 || at > bottom + 1) continue;
    pen.moveTo(left - 4, at);
    pen.lineTo(left, at);
    pen.fillText(text, left - 7, at, left - 20);
  }
  pen.stroke();
  pen.fillStyle = theme.ink;
  pen.textAlign = "center";
  pen.textBaseline = "bottom";
  pen.fillText(x.title, left + width / 2, bottom + 42, width + left);
  pen.save();
  pen.translate(4, top + height / 2);
  pen.rotate(-Math.PI / 2);
  pen.textBaseline = "top";
  pen.fillText(y.title, 0, 0, height + 30);
  pen.restore();
}
