// Places of a map's rows: as cells of a grid, as quarters of a refined mesh's cells, or as marks.
import { axisMapping, makeScale } from "./axes.js";
import { clamp, rowLottery } from "./numbers.js";

/** @import { Scale } from "./axes.js" */
/** @import { Column, Table } from "./data.js" */
/** @import { Form } from "./main.js" */

/**
 * Rows and where they are; boxes are left, low, right and high as shares of the axes.
 * @typedef {object} PlacedRows
 * @property {Scale} x
 * @property {Scale} y
 * @property {Form} form
 * @property {Int32Array} rows
 * @property {Float64Array} boxes four for each of `rows`; for marks the first two are the position
 * @property {Int32Array} cell index of the cell, or for marks of the bin, of each of `rows`
 * @property {number} bins bins along either axis for marks; else 0
 * @property {Float64Array} outlines of a refined mesh's cells, four each
 */

const MAX_GRID_VALUES = 400; // with more values along an axis, a grid is drawn as marks

/** @type {Pick<PlacedRows, "form" | "bins" | "outlines">} of a plain grid */
const PLAIN_GRID = { form: "cells", bins: 0, outlines: new Float64Array() };

/**
 * @param {Table} table
 * @param {Column} x
 * @param {Column} y
 * @param {(row: number) => boolean} within whether a row lies in the slice shown
 * @param {number} room number of ticks that fit
 * @returns {PlacedRows}
 */
export function placeRows(table, x, y, within, room) {
  const rows = [];
  for (let row = 0; row < table.rows; row++)
    if (within(row) && !Number.isNaN(x.values[row]) && !Number.isNaN(y.values[row])) rows.push(row);
  const about = table.about.refined_cells;
  if (about && table.mesh && about.axes.includes(x.key) && about.axes.includes(y.key) && x !== y)
    return placeInMesh(table, x, y, within, room, about.axes[0] === x.key);
  const [across, up] = [distinctValues(x.values, rows), distinctValues(y.values, rows)];
  const full = across.length * up.length <= 2 * rows.length || (x.names && y.names);
  const gridded = full && x.axis && y.axis && Math.max(across.length, up.length) <= MAX_GRID_VALUES && rows.length > 1;
  if (!gridded) return placeAsMarks(x, y, rows, room);
  const [sx, sy] = [makeScale(x, across, room), makeScale(y, up, room)];
  return placeInCells(x, y, sx, sy, rows);
}

/**
 * Distinct values of some rows, sorted.
 * @type {(values: Float64Array, rows: number[]) => Float64Array}
 */
function distinctValues(values, rows) {
  const seen = new Set();
  for (const row of rows) {
    seen.add(values[row]);
    if (seen.size > MAX_GRID_VALUES) break;
  }
  return Float64Array.from(seen).sort();
}

/**
 * Place rows in the cells of a grid; rows of one cell share its width.
 * @type {(x: Column, y: Column, sx: Scale, sy: Scale, rows: number[]) => PlacedRows}
 */
function placeInCells(x, y, sx, sy, rows) {
  const column = new Map(Array.from(sx.cells ?? [], (value, k) => [value, k]));
  const line = new Map(Array.from(sy.cells ?? [], (value, k) => [value, k]));
  const wide = column.size;
  const cell = Int32Array.from(rows, (row) => (line.get(y.values[row]) ?? 0) * wide + (column.get(x.values[row]) ?? 0));
  const counts = new Int32Array(wide * line.size);
  for (const one of cell) counts[one]++;
  const taken = new Int32Array(counts.length);
  const boxes = new Float64Array(4 * rows.length);
  rows.forEach((_, k) => {
    const [i, j] = [cell[k] % wide, Math.floor(cell[k] / wide)];
    const [left, right] = [sx.edges?.[i] ?? 0, sx.edges?.[i + 1] ?? 1];
    const step = (right - left) / counts[cell[k]];
    const start = left + step * taken[cell[k]]++;
    boxes.set([start, sy.edges?.[j] ?? 0, start + step, sy.edges?.[j + 1] ?? 1], 4 * k);
  });
  return { ...PLAIN_GRID, x: sx, y: sy, rows: Int32Array.from(rows), boxes, cell };
}

/** @type {(x: Column, y: Column, rows: number[], room: number) => PlacedRows} */
function placeAsMarks(x, y, rows, room) {
  const [sx, sy] = [makeScale(x, null, room), makeScale(y, null, room)];
  const boxes = new Float64Array(4 * rows.length);
  rows.forEach((row, k) => {
    boxes[4 * k] = sx.to(x.values[row] + (x.names ? jitter(row) : 0));
    boxes[4 * k + 1] = sy.to(y.values[row] + (y.names ? jitter(row + 1) : 0));
  });
  const bins = clamp(Math.round(Math.sqrt(rows.length / 20)), 3, 40); // bins of some 20 marks for a rate
  const bin = (/** @type {number} */ share) => clamp(Math.floor(share * bins), 0, bins - 1);
  const cell = Int32Array.from(rows, (_, k) => bin(boxes[4 * k + 1]) * bins + bin(boxes[4 * k]));
  return { ...PLAIN_GRID, x: sx, y: sy, form: "marks", rows: Int32Array.from(rows), boxes, cell, bins };
}

/**
 * Offset of a mark from the middle of its name's cell, so that marks do not cover each other.
 * @type {(row: number) => number}
 */
function jitter(row) {
  return rowLottery(row) / 1400 - 0.357;
}

/**
 * Place rows in a refined map: each quarter of a cell has the colour of the rollout at its corner.
 * @param {Table} table
 * @param {Column} x
 * @param {Column} y
 * @param {(row: number) => boolean} within
 * @param {number} room
 * @param {boolean} straight whether x is the first of the mesh's axes
 * @returns {PlacedRows}
 */
function placeInMesh(table, x, y, within, room, straight) {
  const [sx, sy] = [x, y].map((column) => {
    return { ...makeScale(column, null, room), ...axisMapping(column) }; // without room at the ends
  });
  const corners = table.mesh ?? new Int32Array();
  const [rows, boxes, outlines] = [
    /** @type {number[]} */ ([]),
    /** @type {number[]} */ ([]),
    /** @type {number[]} */ ([]),
  ];
  for (let k = 0; k < corners.length; k += 4) {
    const four = straight
      ? corners.subarray(k, k + 4)
      : Int32Array.of(corners[k], corners[k + 2], corners[k + 1], corners[k + 3]);
    if (!within(four[0])) continue;
    const [left, right] = [sx.to(x.values[four[0]]), sx.to(x.values[four[1]])];
    const [low, high] = [sy.to(y.values[four[0]]), sy.to(y.values[four[2]])];
    const [middle, half] = [(left + right) / 2, (low + high) / 2];
    rows.push(...four);
    boxes.push(left, low, middle, half, middle, low, right, half, left, half, middle, high, middle, half, right, high);
    outlines.push(left, low, right, high);
  }
  return {
    ...PLAIN_GRID,
    x: sx,
    y: sy,
    rows: Int32Array.from(rows),
    boxes: Float64Array.from(boxes),
    cell: Int32Array.from(rows, (_, k) => k),
    outlines: Float64Array.from(outlines),
  };
}
