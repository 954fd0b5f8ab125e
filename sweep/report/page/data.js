// What the page holds, read: rows by column, the cells of a refined map, densities.
// The records from `Kind` to `About` are what Python writes (`data.py`, `stage.py`): a test holds both to the same keys.
import { clamp } from "./numbers.js";

/**
 * @typedef {object} Kind
 * @property {string} key
 * @property {string} label
 * @property {string} meaning
 * @property {number} count
 * @property {string} colour
 * @property {number[]} shape corners of its mark, x and y in turn, y up
 * @property {"success" | "failure" | "invalid"} outcome
 */

/**
 * A column; what stands for its values is either names, listed levels, or two ends and the bend between them.
 * @typedef {object} Told
 * @property {string} key
 * @property {string} label
 * @property {string} unit
 * @property {string} path of a parameter, with its unit; empty for a figure
 * @property {boolean} axis
 * @property {boolean} drawn
 * @property {boolean} diverges whether it is good above zero and bad below it
 * @property {number | null} limit
 * @property {string[]} [names]
 * @property {number[]} [levels]
 * @property {number} [low]
 * @property {number} [step]
 * @property {number} [bend]
 * @property {number} [middle]
 */

/**
 * @typedef {object} Theory
 * @property {string} label
 * @property {string} of
 * @property {string} along
 * @property {(number | null)[]} at
 * @property {(number | null)[]} limit
 */

/**
 * @typedef {object} Binned
 * @property {string} x
 * @property {string} y
 * @property {number} wide
 * @property {number} high
 * @property {number[]} x_ends
 * @property {number[]} y_ends
 * @property {string} block
 */

/**
 * @typedef {object} Mesh
 * @property {string[]} axes
 * @property {string} block rows at the corners of cells, four a cell
 */

/**
 * @typedef {object} Arrow
 * @property {number} metres for a newton
 * @property {number} least newtons that have an arrow
 */

/**
 * @typedef {object} Shown
 * @property {number} row
 * @property {string} point
 * @property {string} kind
 * @property {string} title
 * @property {string} why
 * @property {number} equal
 * @property {number} of
 * @property {number} model
 * @property {number} step
 * @property {number} frames
 * @property {number[]} scales
 * @property {number} force_scale
 * @property {number} torque_scale 0 where no torques are kept
 * @property {number | null} torque_limit N m
 * @property {number} margin_scale
 * @property {number} friction_scale of shares of the friction that there is, 0 where they are not kept
 * @property {string[]} limits that a margin is kept to, none where it is not
 * @property {string[]} stages
 */

/**
 * @typedef {object} About
 * @property {string} name
 * @property {string} folder
 * @property {number} total
 * @property {number} rows
 * @property {Kind[]} kinds
 * @property {string[]} stages
 * @property {Told[]} columns
 * @property {number} digits
 * @property {string} block
 * @property {boolean} one_at_a_time whether each parameter was varied alone
 * @property {boolean} sure whether every row is an independent draw, so that all of them have an interval
 * @property {boolean} independent whether a test may take every row as independent
 * @property {boolean} adaptive whether rollouts were placed by a search for failures: their shares are no rates
 * @property {Record<string, number> | null} effects of a refined map, by column
 * @property {string[]} start
 * @property {Theory[]} theory
 * @property {Mesh | null} refined_cells
 * @property {Binned[]} densities
 * @property {Shown[]} replays
 * @property {string} models
 * @property {number} left_out
 * @property {number} open
 * @property {Arrow} arrow
 * @property {string[]} legs colours of the legs
 * @property {{ success: string, failure: string }} colours of all that succeed, and of all that fail
 */

/**
 * @typedef {object} Column
 * @property {string} key
 * @property {string} label
 * @property {string} unit
 * @property {string} title label and unit
 * @property {string} path of a parameter, with its unit; empty for a figure
 * @property {boolean} axis
 * @property {boolean} drawn
 * @property {boolean} diverges
 * @property {number | null} limit
 * @property {string[] | null} names of the codes that are its values
 * @property {Float64Array} values NaN where there is none
 * @property {number} low
 * @property {number} high
 */

/**
 * @typedef {object} Table
 * @property {About} about
 * @property {number} rows
 * @property {Uint8Array} kind index of each row's kind
 * @property {Uint8Array} stage one more than the index of its stage, 0 without one
 * @property {Column[]} columns
 * @property {Map<string, Column>} named by key
 * @property {Uint8Array} ids bytes of point ids
 * @property {Int32Array | null} mesh rows at the corners of cells, four a cell
 * @property {Map<number, number>} replayed replays by row
 */

const NONE = 65535;
export const LONGEST = 120; // letters of a name that are shown

/**
 * The bytes that a text of the page stands for.
 * @type {(text: string) => Promise<ArrayBuffer>}
 */
export async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

/**
 * A name that is not too long to be shown.
 * @type {(text: string) => string}
 */
export function clipped(text) {
  return text.length > LONGEST ? `${text.slice(0, LONGEST)}…` : text;
}

/** @type {(about: About) => Promise<Table>} */
export async function readTable(about) {
  const { rows } = about;
  const buffer = await inflate(about.block);
  const bytes = new Uint8Array(buffer);
  const half = about.digits / 2;
  let at = (2 + half) * rows;
  const columns = about.columns.map((told) => {
    const values = readColumn(told, bytes.subarray(at, at + 2 * rows), rows);
    at += 2 * rows;
    return columnOf(told, values);
  });
  return {
    about,
    rows,
    kind: bytes.subarray(0, rows),
    stage: bytes.subarray(rows, 2 * rows),
    ids: bytes.subarray(2 * rows, (2 + half) * rows),
    columns,
    named: new Map(columns.map((column) => [column.key, column])),
    mesh: about.refined_cells ? new Int32Array(await inflate(about.refined_cells.block)) : null,
    replayed: new Map(about.replays.map((one, k) => /** @type {const} */ ([one.row, k])).filter(([row]) => row >= 0)),
  };
}

/**
 * Values of a column, from all its low bytes and then all its high ones.
 * @type {(told: Told, bytes: Uint8Array, rows: number) => Float64Array}
 */
export function readColumn(told, bytes, rows) {
  const values = new Float64Array(rows);
  const { levels, low = 0, step = 1, bend = 0, middle = 0 } = told;
  for (let k = 0; k < rows; k++) {
    const code = bytes[k] | (bytes[rows + k] << 8);
    if (code === NONE) values[k] = NaN;
    else if (told.names) values[k] = code;
    else if (levels) values[k] = levels[code];
    else values[k] = bend ? middle + bend * Math.sinh(low + step * code) : low + step * code;
  }
  return values;
}

/** @type {(told: Told, values: Float64Array) => Column} */
function columnOf(told, values) {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (!(high >= low)) low = high = 0;
  const label = clipped(told.label);
  const title = told.unit ? `${label} [${told.unit}]` : label;
  const names = told.names ? told.names.map(clipped) : null;
  const path = told.path ?? ""; // a page that an earlier version wrote has none
  return { ...told, label, title, path, names, values, low, high };
}

/**
 * The beginning of a row's point id.
 * @type {(table: Table, row: number) => string}
 */
export function pointOf(table, row) {
  const half = table.about.digits / 2;
  const bytes = table.ids.subarray(row * half, (row + 1) * half);
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * Counts of densities by kind, from their bytes in planes.
 * @type {(buffer: ArrayBuffer) => Uint32Array}
 */
export function readCounts(buffer) {
  const bytes = new Uint8Array(buffer);
  const size = bytes.length / 4;
  const counts = new Uint32Array(size);
  for (let plane = 0; plane < 4; plane++)
    for (let k = 0; k < size; k++) counts[k] += bytes[plane * size + k] * 2 ** (8 * plane);
  return counts;
}

/**
 * Replayed rows by their distance from a row, in units of the range of each parameter; a name that differs counts one.
 * The row's own replay comes first.
 * @param {Table} table
 * @param {number} row
 * @returns {number} the replay's number, -1 where there is none
 */
export function nearestReplay(table, row) {
  const own = table.replayed.get(row);
  if (own !== undefined) return own;
  let best = -1;
  let least = Infinity;
  const axes = table.columns.filter((column) => column.axis);
  for (const [other, number] of table.replayed) {
    let sum = table.kind[other] === table.kind[row] ? 0 : 1e-9; // of two as far, the one that ends alike
    for (const { names, values, low, high } of axes) {
      const apart = names ? Number(values[row] !== values[other]) : (values[row] - values[other]) / (high - low || 1);
      sum += apart * apart || 0;
    }
    if (sum < least) [best, least] = [number, sum];
  }
  return best;
}

/**
 * How differently a column's values are distributed in two sets of rows (Kolmogorov and Smirnov's distance), and whether
 * that would be seldom by chance (5 %). `order` are the rows by value.
 * @param {ArrayLike<number>} order
 * @param {ArrayLike<number>} values
 * @param {(row: number) => number} side 0 or 1 for the sets, anything else for neither
 * @returns {{ distance: number, told: boolean, counts: [number, number] }}
 */
export function smirnov(order, values, side) {
  /** @type {[number, number]} */
  const counts = [0, 0];
  for (let k = 0; k < order.length; k++) {
    const of = side(order[k]);
    if (of === 0 || of === 1) counts[of]++;
  }
  if (!counts[0] || !counts[1]) return { distance: 0, told: false, counts };
  const seen = [0, 0];
  let distance = 0;
  for (let k = 0; k < order.length; k++) {
    const of = side(order[k]);
    if (of === 0 || of === 1) seen[of]++;
    if (k + 1 < order.length && values[order[k + 1]] === values[order[k]]) continue;
    distance = Math.max(distance, Math.abs(seen[0] / counts[0] - seen[1] / counts[1]));
  }
  const root = Math.sqrt((counts[0] * counts[1]) / (counts[0] + counts[1]));
  const rare = 1.358 / (root + 0.12 + 0.11 / root); // of few rows, too (Stephens 1970)
  return { distance, told: distance > rare, counts };
}

/**
 * How differently a column's names are distributed in two sets of rows: the largest difference of the shares of any
 * choice of names (total variation; what Kolmogorov and Smirnov's distance is for numbers), and whether that would be
 * seldom by chance (5 %, chi-squared test of homogeneity).
 * @param {Column} column
 * @param {(row: number) => number} side 0 or 1 for the sets, anything else for neither
 * @returns {{ distance: number, told: boolean, counts: [number, number] }}
 */
export function nameDistance({ names, values }, side) {
  const seen = (names ?? []).map(() => [0, 0]);
  /** @type {[number, number]} */
  const counts = [0, 0];
  for (let row = 0; row < values.length; row++) {
    const of = side(row);
    if ((of !== 0 && of !== 1) || !seen[values[row]]) continue;
    seen[values[row]][of]++;
    counts[of]++;
  }
  if (!counts[0] || !counts[1]) return { distance: 0, told: false, counts };
  let distance = 0;
  let square = 0;
  let degrees = -1;
  for (const [good, bad] of seen) {
    if (!good && !bad) continue;
    degrees++;
    const apart = good / counts[0] - bad / counts[1];
    distance += Math.abs(apart) / 2;
    square += (apart * apart * counts[0] * counts[1]) / (good + bad);
  }
  // 95 % quantile of chi-squared (Wilson and Hilferty 1931)
  const limit = degrees > 0 ? degrees * (1 - 2 / (9 * degrees) + 1.6449 * Math.sqrt(2 / (9 * degrees))) ** 3 : Infinity;
  return { distance, told: square > limit, counts };
}

/**
 * How differently a parameter is distributed in two sets of rows, whether it has numbers or names.
 * @type {(column: Column, order: (column: Column) => Uint32Array, side: (row: number) => number)
 *   => { distance: number, told: boolean, counts: [number, number] }}
 */
export function distanceOf(column, order, side) {
  return column.names ? nameDistance(column, side) : smirnov(order(column), column.values, side);
}

/**
 * Rows in the order of a column's values; those without one are left out.
 * @type {(column: Column) => Uint32Array}
 */
export function orderOf(column) {
  const { values } = column;
  const rows = [];
  for (let row = 0; row < values.length; row++) if (!Number.isNaN(values[row])) rows.push(row);
  return Uint32Array.from(rows).sort((a, b) => values[a] - values[b] || a - b);
}

/**
 * Rows of a column by bins of equal width along an axis.
 * @param {Column} column
 * @param {number} bins
 * @param {(value: number) => number} to the share of the axis
 * @returns {Uint8Array} 255 for none
 */
export function binsOf({ values }, bins, to) {
  return Uint8Array.from(values, (value) =>
    Number.isNaN(value) ? 255 : clamp(Math.floor(to(value) * bins), 0, bins - 1),
  );
}

/**
 * The values of a column that are those of a grid, or its names' codes; sorted.
 * @type {(column: Column) => number[] | null}
 */
export function gridOf(column) {
  if (column.names) return column.names.map((_, code) => code);
  return column.axis && !column.drawn ? valuesOf(column) : null;
}

/**
 * The values of a column, each once, sorted.
 * @type {(column: Column) => number[]}
 */
export function valuesOf({ values }) {
  return [...new Set(values)].filter((value) => !Number.isNaN(value)).sort((a, b) => a - b);
}
