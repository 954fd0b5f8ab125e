// Axes of charts: conversion between values and pixels, ticks and titles.
import {
  asinhLike,
  clamp,
  cellEdges,
  formatApart,
  isRoundingRange,
  lastIndexBelow,
  ticks,
  inverseAsinhLike,
} from "./numbers.js";

/** @import { Column } from "./data.js" */
/** @import { Sheet, Theme } from "./dom.js" */
/** @typedef {{ value: number, text: string }} Mark along an axis */
/** @typedef {{ scale: Scale, title: string }} Titled */

/**
 * Conversion between values and shares of an axis, 0 to 1.
 * @typedef {object} Scale
 * @property {(value: number) => number} to
 * @property {(share: number) => number} back
 * @property {Mark[]} ticks
 * @property {Float64Array | null} edges of cells as shares, if the axis has cells
 * @property {Float64Array | null} cells their values
 */

const UNEVEN_RATIO = 3; // if gaps between cells differ by more than this factor, cells get equal width

/**
 * Make the scale of a column: one cell for each name or value in `cells`, else linear with some room at the ends.
 * @param {Column} column
 * @param {Float64Array | null} cells sorted values
 * @param {number} room number of ticks that fit
 * @returns {Scale}
 */
export function makeScale(column, cells, room) {
  if (column.names) {
    const count = column.names.length;
    const values = Float64Array.from({ length: count }, (_, k) => k);
    const every = Math.max(1, Math.ceil(count / room));
    const marks = column.names.map((text, value) => ({ value, text })).filter(({ value }) => value % every === 0);
    const edges = Float64Array.from({ length: count + 1 }, (_, k) => k / count); // also below the first name, whose code is 0
    return { ...linearScale(-0.5, count - 0.5, marks, null), edges, cells: values };
  }
  if (!cells && column.diverges) return asinhScale(column, room);
  if (!cells) {
    const same = isRoundingRange(column.low, column.high);
    const margin = same ? 0.5 * Math.abs(column.high) || 0.5 : 0.03 * (column.high - column.low);
    const low = column.low >= 0 ? Math.max(0, column.low - margin) : column.low - margin;
    return linearScale(low, column.high + margin, labelledTicks(low, column.high + margin, room), null);
  }
  const gaps = Array.from(cells.subarray(1), (value, k) => value - cells[k]);
  if (!gaps.length || Math.max(...gaps) < UNEVEN_RATIO * Math.min(...gaps)) {
    const edges = cellEdges(cells);
    const [low, high] = [edges[0], edges[edges.length - 1]];
    const few = cells.length <= room / 1.5;
    const marks = few ? labelledValues(Array.from(cells)) : labelledTicks(low, high, room);
    return linearScale(low, high, marks, cells);
  }
  return equalCellScale(cells, room);
}

/** @type {(low: number, high: number, room: number) => Mark[]} */
function labelledTicks(low, high, room) {
  return labelledValues(ticks(low, high, room));
}

/** @type {(values: number[]) => Mark[]} */
function labelledValues(values) {
  const texts = formatApart(values);
  return values.map((value, k) => ({ value, text: texts[k] }));
}

/** @type {(low: number, high: number, marks: Mark[], cells: Float64Array | null) => Scale} */
function linearScale(low, high, marks, cells) {
  const size = high - low || 1;
  const to = (/** @type {number} */ value) => (value - low) / size;
  const edges = cells ? cellEdges(cells).map((edge) => clamp(to(edge), 0, 1)) : null;
  return { to, back: (share) => low + share * size, ticks: marks, edges, cells };
}

/**
 * Make a scale that is linear near zero and logarithmic beyond, so that values near zero are told apart.
 * @type {(column: Column, room: number) => Scale}
 */
function asinhScale({ low, high }, room) {
  const [first, last] = [asinhLike(low) - 0.1, asinhLike(high) + 0.1];
  const to = (/** @type {number} */ value) => (asinhLike(value) - first) / (last - first);
  const marks = labelledValues(asinhTicks(low, high, room));
  return {
    to,
    back: (share) => inverseAsinhLike(first + share * (last - first)),
    ticks: marks,
    edges: null,
    cells: null,
  };
}

/**
 * Ticks at zero, then at the outermost round numbers on both sides, then at powers of ten and other round numbers as far
 * as there is room between them.
 * @type {(low: number, high: number, room: number) => number[]}
 */
function asinhTicks(low, high, room) {
  const size = Math.max(-low, high);
  const count = Math.max(1, Math.ceil(Math.log10(size / 0.1)) + 1);
  const powers = Array.from({ length: count }, (_, k) => 10 ** (k - 1));
  const within = (/** @type {number} */ value) => value >= low && value <= high;
  const signed = (/** @type {number[]} */ sizes) => sizes.flatMap((value) => [-value, value]).filter(within);
  const round = signed(powers.flatMap((power) => [power, 2 * power, 5 * power]));
  const outermost = round.length ? [Math.min(...round), Math.max(...round)] : [];
  const least = (asinhLike(high) - asinhLike(low)) / (1.5 * room);
  const apart = (/** @type {number} */ a, /** @type {number} */ b) => Math.abs(asinhLike(a) - asinhLike(b)) >= least;
  /** @type {number[]} */
  const found = [];
  for (const value of [0, ...outermost, ...signed(powers).reverse(), ...round])
    if ((value === 0 || within(value)) && found.every((other) => apart(value, other))) found.push(value);
  return found.sort((a, b) => a - b);
}

/** @typedef {"inverted" | "log"} Way of an axis that is not upright, or not even */
/** @typedef {Pick<Scale, "to" | "back">} Along */

/**
 * Conversion between values of a column and shares of an axis from its lowest to its highest: linear, or inverse hyperbolic
 * sine if the column diverges about zero.
 * @type {(column: Column, way?: Way) => Along}
 */
export function axisMapping({ low, high, diverges }, way) {
  if (isRoundingRange(low, high)) return { to: () => 0.5, back: () => low };
  const [on, off] = way === "log" ? [Math.log, Math.exp] : diverges ? [asinhLike, inverseAsinhLike] : [Number, Number];
  const [first, last] = way === "inverted" ? [high, low] : [low, high];
  const [start, size] = [on(first), on(last) - on(first)];
  return {
    to: (value) => (on(value) - start) / size,
    back: (share) => (share <= 0 ? first : share >= 1 ? last : off(start + share * size)), // exact at the ends
  };
}

/**
 * Ticks along such an axis: round values, or names.
 * @type {(column: Column, way: Way | undefined, room: number) => number[]}
 */
export function axisTicks({ names, low, high, diverges }, way, room) {
  if (names) {
    const every = Math.ceil(names.length / (3 * room)); // horizontal words
    return names.map((_, k) => k).filter((k) => k > low && k < high && k % every === 0);
  }
  if (way === "log") {
    const [first, last] = [Math.ceil(Math.log10(low)), Math.floor(Math.log10(high))];
    const every = Math.max(1, Math.ceil((last - first + 1) / room));
    return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => 10 ** (first + k)).filter(
      (_, k) => k % every === 0,
    );
  }
  return diverges ? asinhTicks(low, high, room) : ticks(low, high, room);
}

/**
 * Range of values between two shares of an axis, snapped to the sorted values of a grid.
 * @type {(along: Along, grid: number[] | null, a: number, b: number) => { low: number, high: number }}
 */
export function snapToGrid({ to, back }, grid, a, b) {
  if (!grid) return wholeCells({ edges: null, back }, a, b);
  const places = grid.map(to).sort((p, q) => p - q);
  const edges = Float64Array.of(0, ...places.slice(1).map((place, k) => (places[k] + place) / 2), 1);
  return wholeCells({ edges, back }, a, b);
}

/**
 * Range of values between two shares of an axis, widened to whole cells.
 * @type {(scale: Pick<Scale, "edges" | "back">, a: number, b: number) => { low: number, high: number }}
 */
export function wholeCells({ edges, back }, a, b) {
  const [low, high] = [Math.min(a, b), Math.max(a, b)];
  if (!edges) return { low: back(low), high: back(high) };
  const below = edges.findLast((edge) => edge <= low + 1e-9) ?? 0;
  const above = edges.find((edge) => edge >= high - 1e-9) ?? 1;
  return { low: back(below), high: back(above) };
}

/**
 * Make a scale with cells of equal width, for values that are not evenly spaced.
 * @type {(cells: Float64Array, room: number) => Scale}
 */
export function equalCellScale(cells, room) {
  const count = cells.length;
  const to = (/** @type {number} */ value) => {
    const k = clamp(lastIndexBelow(cells, value), 0, count - 2);
    return (clamp(k + (value - cells[k]) / (cells[k + 1] - cells[k]), -0.5, count - 0.5) + 0.5) / count;
  };
  const back = (/** @type {number} */ share) => {
    const place = share * count - 0.5;
    const k = clamp(Math.floor(place), 0, count - 2);
    return cells[k] + (place - k) * (cells[k + 1] - cells[k]);
  };
  const every = Math.max(1, Math.ceil(count / room));
  const marks = labelledValues(Array.from(cells)).filter((_, k) => k % every === 0);
  const edges = Float64Array.from({ length: count + 1 }, (_, k) => k / count);
  return { to, back, ticks: marks, edges, cells };
}

/** @typedef {{ left: number, top: number, width: number, height: number }} Box */

/**
 * Draw the frame of a chart: ticks with numbers along the lower and the left side, and the axes' titles.
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
