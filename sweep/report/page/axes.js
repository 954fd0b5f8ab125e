// Axes of charts: conversion between values and pixels, ticks and titles.
import {
  arcsinh,
  clamp,
  cellEdges,
  formatApart,
  formatShort,
  isRoundingRange,
  lastIndexBelow,
  ticks,
  inverseArcsinh,
} from "./numbers.js";

/** @import { Column } from "./data.js" */
/** @import { Sheet, Theme } from "./dom.js" */
/** @typedef {{ value: number, text: string }} Mark along an axis */
/** @typedef {{ scale: Pick<Scale, "to" | "ticks">, title: string }} Titled */

/** @typedef {"linear" | "log" | "symlog"} ScaleKind linear, logarithmic, or linear near zero and logarithmic beyond */
/** @typedef {Pick<Column, "low" | "high" | "scale" | "linear">} Scaled what of a column its scale depends on */

/**
 * Conversion between values and shares of an axis, 0 to 1.
 * @typedef {object} Scale
 * @property {(value: number) => number} to
 * @property {(share: number) => number} back
 * @property {Mark[]} ticks
 * @property {Float64Array | null} edges of cells as shares, if the axis has cells
 * @property {Float64Array | null} cells their values
 * @property {string} note on a scale that is not linear, for the axis' title
 */

/** @typedef {Pick<Scale, "to" | "back">} Along */

const UNEVEN_RATIO = 3; // if gaps between cells differ by more than this factor, cells get equal width
const END_ROOM = 0.03; // room beyond the outermost marks, as a share of an axis
const TICK_ROOM = 1.5; // gaps between uneven ticks are at least the length of the axis by so many times their number

/**
 * Kinds of scales that a column's axes can have; none for names and for columns of one value.
 * @type {(column: Pick<Column, "names" | "low" | "high">) => ScaleKind[]}
 */
export function allowedScales({ names, low, high }) {
  if (names || isRoundingRange(low, high)) return [];
  return low > 0 ? ["linear", "log", "symlog"] : ["linear", "symlog"];
}

/**
 * The scale that a column's axes have unless the reader chooses another.
 * @type {(column: Pick<Column, "diverges" | "names">) => ScaleKind}
 */
export function columnScale({ diverges, names }) {
  return diverges && !names ? "symlog" : "linear";
}

/**
 * Functions from values to lengths along the scale of a column, and back.
 * @type {(column: Scaled) => [(value: number) => number, (length: number) => number]}
 */
function scaleFunctions({ scale, linear }) {
  if (scale === "log") return [Math.log, Math.exp];
  if (scale === "symlog") return [(value) => arcsinh(value, linear), (length) => inverseArcsinh(length, linear)];
  return [Number, Number];
}

/**
 * Note on a column's scale for the title of an axis; empty for a linear one.
 * @type {(column: Pick<Column, "scale" | "linear" | "names">) => string}
 */
export function scaleNote({ scale, linear, names }) {
  if (names || scale === "linear") return "";
  return scale === "log" ? "log" : `symlog, linear within ±${formatShort(linear)}`;
}

/**
 * Title of an axis: label, unit and scale.
 * @type {(column: Column, scale: { note: string }) => string}
 */
export function axisTitle({ title }, { note }) {
  return note ? `${title} (${note})` : title;
}

/**
 * Make the scale of a column: one cell for each name or value in `cells`, else the column's own scale with some room at
 * the ends.
 * @param {Scaled & Pick<Column, "names">} column
 * @param {Float64Array | null} cells sorted values
 * @param {number} room number of ticks that fit
 * @returns {Scale}
 */
export function makeScale(column, cells, room) {
  if (column.names) {
    const count = column.names.length;
    const values = Float64Array.from({ length: count }, (_, k) => k);
    const every = Math.max(1, Math.ceil(count / room));
    const ticks = column.names.map((text, value) => ({ value, text })).filter(({ value }) => value % every === 0);
    const edges = Float64Array.from({ length: count + 1 }, (_, k) => k / count); // also below the first name, whose code is 0
    const along = alongBetween({ ...column, scale: "linear" }, -0.5, count - 0.5);
    return { ...along, ticks, edges, cells: values, note: "" };
  }
  const note = scaleNote(column);
  const [on, off] = scaleFunctions(column);
  if (!cells) {
    const [low, high] = roomyEnds(column);
    const ticks = labelledValues(scaleTicks(column, low, high, room));
    return { ...alongBetween(column, low, high), ticks, edges: null, cells: null, note };
  }
  const lengths = cells.map(on);
  const gaps = Array.from(lengths.subarray(1), (value, k) => value - lengths[k]);
  if (gaps.length && Math.max(...gaps) >= UNEVEN_RATIO * Math.min(...gaps)) return equalCellScale(cells, room);
  const edges = column.scale === "linear" ? cellEdges(cells) : edgesBetween(lengths).map(off);
  const [low, high] = [edges[0], edges[edges.length - 1]];
  const along = alongBetween(column, low, high);
  const few = cells.length <= room / 1.5;
  const ticks = labelledValues(few ? Array.from(cells) : scaleTicks(column, low, high, room));
  return { ...along, ticks, edges: edges.map((edge) => clamp(along.to(edge), 0, 1)), cells, note };
}

/**
 * Ends of an axis with marks: those of the values, with some room.
 * @type {(column: Scaled) => [number, number]}
 */
function roomyEnds(column) {
  const { low, high, scale } = column;
  const [on, off] = scaleFunctions(column);
  const same = isRoundingRange(low, high);
  if (same) return [low - (0.5 * Math.abs(high) || 0.5), high + (0.5 * Math.abs(high) || 0.5)];
  const room = END_ROOM * (on(high) - on(low));
  const [first, last] = [off(on(low) - room), off(on(high) + room)];
  return [scale === "linear" && low >= 0 ? Math.max(0, first) : first, last];
}

/**
 * Edges half-way between evenly spaced lengths, and as far beyond the outer ones.
 * @type {(lengths: Float64Array) => Float64Array}
 */
function edgesBetween(lengths) {
  const count = lengths.length;
  const half = count > 1 ? (lengths[count - 1] - lengths[0]) / (count - 1) / 2 : 0.5;
  return Float64Array.from({ length: count + 1 }, (_, k) =>
    k === 0 ? lengths[0] - half : k === count ? lengths[count - 1] + half : (lengths[k - 1] + lengths[k]) / 2,
  );
}

/**
 * Conversion along a column's scale between two values.
 * @type {(column: Scaled, first: number, last: number) => Along}
 */
function alongBetween(column, first, last) {
  const [on, off] = scaleFunctions(column);
  const [start, size] = [on(first), on(last) - on(first) || 1];
  return {
    to: (value) => (on(value) - start) / size,
    back: (share) => (share === 0 ? first : share === 1 ? last : off(start + share * size)), // exact at the ends
  };
}

/** @type {(values: number[]) => Mark[]} */
function labelledValues(values) {
  const texts = formatApart(values);
  return values.map((value, k) => ({ value, text: texts[k] }));
}

/**
 * Round values along a column's scale: at equal steps if it is linear; else zero, then the outermost round numbers, then
 * powers of ten and other round numbers as far as there is room between them.
 * @type {(column: Scaled, low: number, high: number, room: number) => number[]}
 */
function scaleTicks(column, low, high, room) {
  const { scale, linear } = column;
  if (scale === "linear") return ticks(low, high, room);
  const [on] = scaleFunctions(column);
  const size = Math.max(Math.abs(low), Math.abs(high));
  const first = Math.floor(Math.log10(scale === "log" ? low : linear));
  const count = Math.max(1, Math.ceil(Math.log10(size)) - first + 1);
  const powers = Array.from({ length: count }, (_, k) => Number(`1e${first + k}`));
  const within = (/** @type {number} */ value) => value >= low && value <= high;
  const signed = (/** @type {number[]} */ sizes) => sizes.flatMap((value) => [-value, value]).filter(within);
  const round = signed(powers.flatMap((power) => [power, 2 * power, 5 * power]));
  if (scale === "log" && round.length < 3) return ticks(low, high, room); // of less than a decade
  const outermost = round.length ? [Math.min(...round), Math.max(...round)] : [];
  const least = (on(high) - on(low)) / (TICK_ROOM * room);
  const apart = (/** @type {number} */ a, /** @type {number} */ b) => Math.abs(on(a) - on(b)) >= least;
  /** @type {number[]} */
  const found = [];
  for (const value of [...(within(0) ? [0] : []), ...outermost, ...signed(powers).reverse(), ...round])
    if (found.every((other) => apart(value, other))) found.push(value);
  return found.sort((a, b) => a - b);
}

/**
 * Conversion between values of a column and shares of an axis from its lowest to its highest value.
 * @type {(column: Scaled, inverted?: boolean) => Along}
 */
export function axisMapping(column, inverted = false) {
  const { low, high } = column;
  if (isRoundingRange(low, high)) return { to: () => 0.5, back: () => low };
  const { to, back } = inverted ? alongBetween(column, high, low) : alongBetween(column, low, high);
  return { to, back: (share) => back(clamp(share, 0, 1)) };
}

/**
 * Ticks along such an axis: round values, or names.
 * @type {(column: Scaled & Pick<Column, "names">, room: number) => number[]}
 */
export function axisTicks(column, room) {
  const { names, low, high } = column;
  if (!names) return scaleTicks(column, low, high, room);
  const every = Math.ceil(names.length / (3 * room)); // horizontal words
  return names.map((_, k) => k).filter((k) => k > low && k < high && k % every === 0);
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
  return { to, back, ticks: marks, edges, cells, note: "not to scale" };
}

/** @typedef {{ left: number, top: number, width: number, height: number }} Box */

/**
 * Box of a chart on its canvas, inside the margins.
 * @type {(canvas: HTMLCanvasElement, margin: { left: number, right: number, top: number, bottom: number }) => Box}
 */
export function chartBox({ clientWidth, clientHeight }, { left, right, top, bottom }) {
  const [width, height] = [clientWidth - left - right, clientHeight - top - bottom];
  return { left, top, width: Math.max(10, width), height: Math.max(10, height) };
}

/**
 * Point of a box at shares of its axes, in CSS pixels.
 * @type {(box: Box, across: number, up: number) => [number, number]}
 */
export function pointInBox({ left, top, width, height }, across, up) {
  return [left + across * width, top + (1 - up) * height];
}

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
