// Decoding of the page's data: rows by column, cells of a refined map, densities.
// Python writes the records from `Kind` to `About` (`data.py`, `replay_data.py`); a test compares their keys.
import { columnScale } from "./axes.js";
import { clamp } from "./numbers.js";

/** @import { ScaleKind } from "./axes.js" */
/** @import { Push } from "./kinematics.js" */

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
 * Format of a column. Its codes stand for names, for listed levels, or for a range, linear or by inverse hyperbolic sine.
 * @typedef {object} ColumnFormat
 * @property {string} key
 * @property {string} label
 * @property {string} unit
 * @property {string} path of a parameter, with its unit; empty for a metric
 * @property {boolean} axis
 * @property {boolean} drawn
 * @property {boolean} diverges whether positive values are good and negative ones bad
 * @property {number | null} limit
 * @property {string[]} [names]
 * @property {number[]} [levels]
 * @property {number} [low]
 * @property {number} [step]
 * @property {number} [bend]
 * @property {number} [middle]
 * @property {boolean} [derived] whether the page alone has it, so that no command knows it
 */

/**
 * A group of failures of one kind.
 * @typedef {object} Mode
 * @property {string} label
 * @property {number} share of the failure probability
 * @property {number} rows
 * @property {string} place parameters in which it is far from plain draws, in standard deviations
 * @property {{ kind: string, share: number }[]} causes and their shares of the mode
 */

/**
 * The failure probability that a search for failures estimates.
 * @typedef {object} Estimate
 * @property {number} probability
 * @property {number | null} low end of the 95 % interval, null if there is none
 * @property {number | null} high
 * @property {boolean} reliable
 * @property {Mode[]} modes the largest first
 */

/**
 * A region of parameters in which few draws fail, as `sweep certify` found it.
 * @typedef {object} Region
 * @property {string} text what is certified
 * @property {string[]} start the two parameters that it is cut along most
 * @property {{ x: string, y: string, lines: number[][] }[]} outlines over pairs of parameters: x and y in turn
 * @property {boolean} section whether outlines are sections through the middle of the region
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
 * A parameter that varies alone, with the intervals of the success rate where it has any.
 * @typedef {object} Curve
 * @property {string} key
 * @property {number | null} nominal
 * @property {number[]} at values with an interval
 * @property {number[]} low
 * @property {number[]} high
 * @property {string} block its rows
 */

/**
 * @typedef {object} Arrow
 * @property {number} metres for a newton
 * @property {number} least smallest force with an arrow, N
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
 * @property {number} torque_scale 0 if torques are not stored
 * @property {number | null} torque_limit N m
 * @property {number} margin_scale
 * @property {number} friction_scale scale of used friction shares, 0 if they are not stored
 * @property {string[]} limits thresholds of the margin, empty if it is not stored
 * @property {{ title: string, names: string[], middles: number[], steps: number[] }[]} [signals] of a learned policy
 * @property {Push[]} [pushes] missing in pages of earlier versions, as signals are
 * @property {string[]} stages
 */

/**
 * Outcomes of the same points for two studies or several policies, on a page that compares them.
 * @typedef {object} SidesFormat
 * @property {Kind[]} styles kinds of outcomes that occur in either
 * @property {string[]} names
 * @property {string[]} folders of two studies; empty for policies
 * @property {{ success: number, valid: number }[]} counts of all rollouts
 * @property {string} block kinds of the rows, those of a side after those of the side before
 */

/** @typedef {Omit<SidesFormat, "block"> & { kinds: Uint8Array[] }} Sides */

/**
 * @typedef {object} About
 * @property {string} name
 * @property {string} folder
 * @property {string} setup scenario, robot, engine, design and number of rollouts
 * @property {number} total
 * @property {number} rows
 * @property {Kind[]} kinds
 * @property {string[]} stages
 * @property {ColumnFormat[]} columns
 * @property {number} digits
 * @property {string} block
 * @property {boolean} one_at_a_time whether each parameter was varied alone
 * @property {boolean} sure whether all rows are independent draws, so that their rate has a confidence interval
 * @property {boolean} independent whether tests may treat rows as independent
 * @property {boolean} adaptive whether a search for failures placed the rollouts, so that their shares are no rates
 * @property {Estimate | null} estimate of a search for failures
 * @property {Region | null} region that is certified
 * @property {Curve[]} curves parameters that vary alone; empty for other studies
 * @property {Record<string, number> | null} effects Sobol indices of a refined map, by column
 * @property {string[]} start
 * @property {SidesFormat | null} [sides] of a page that compares studies or policies
 * @property {Theory[]} theory
 * @property {Mesh | null} refined_cells
 * @property {Binned[]} densities
 * @property {Shown[]} replays
 * @property {string} models
 * @property {number} left_out
 * @property {number} open
 * @property {Arrow} arrow
 * @property {string[]} legs colours of the legs
 * @property {number} reload_s seconds after which the page of a study that runs loads its next version; 0 for never
 * @property {{ success: string, failure: string }} colours of successes and failures in general
 */

/**
 * @typedef {object} Column
 * @property {string} key
 * @property {string} label
 * @property {string} unit
 * @property {string} title label and unit
 * @property {string} path of a parameter, with its unit; empty for a metric
 * @property {boolean} axis
 * @property {boolean} drawn
 * @property {boolean} diverges
 * @property {number | null} limit
 * @property {boolean} [derived] whether the page alone has it, so that no command knows it
 * @property {string[] | null} names by code; the values are codes
 * @property {Float64Array} values NaN if missing
 * @property {number} low
 * @property {number} high
 * @property {ScaleKind} scale of its axes in all views, which the reader may choose
 * @property {number} linear range about zero within which a symlog scale is linear
 */

/** @typedef {Omit<Curve, "key" | "block"> & { column: Column, rows: Int32Array }} AloneAxis */

/**
 * @typedef {object} Table
 * @property {About} about
 * @property {number} rows
 * @property {Uint8Array} kind index of each row's kind
 * @property {Uint8Array} stage index of its stage plus one, 0 without a stage
 * @property {Column[]} columns
 * @property {Map<string, Column>} named by key
 * @property {Uint8Array} ids bytes of point ids
 * @property {Int32Array | null} mesh rows at the corners of cells, four a cell
 * @property {AloneAxis[]} alone parameters that vary alone
 * @property {Map<number, number>} replayed replays by row
 * @property {Sides | null} sides of a page that compares studies or policies
 */

const MISSING = 65535;
const MARGIN_LINEAR = 0.1; // within which scales of a margin are linear, in units of the limit
const SMALL_SHARE = 0.1; // share of the values that may lie within the linear part of a symlog scale
const CLIPPED_FACTOR = 0.5; // of the range between the 1st and 99th percentile: values farther beyond it are clipped
export const NAME_LENGTH = 120; // characters of a name that are shown

/**
 * Decode base64 and inflate the bytes.
 * @type {(text: string) => Promise<ArrayBuffer>}
 */
export async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

/**
 * Shorten a long name.
 * @type {(text: string) => string}
 */
export function clipName(text) {
  return text.length > NAME_LENGTH ? `${text.slice(0, NAME_LENGTH)}…` : text;
}

/** @type {(about: About) => Promise<Table>} */
export async function readTable(about) {
  const { rows } = about;
  const buffer = await inflate(about.block);
  const bytes = new Uint8Array(buffer);
  const half = about.digits / 2;
  let at = (2 + half) * rows;
  const columns = about.columns.map((format) => {
    const values = readColumn(format, bytes.subarray(at, at + 2 * rows), rows);
    at += 2 * rows;
    return makeColumn(format, values);
  });
  const named = new Map(columns.map((column) => [column.key, column]));
  const alone = (about.curves ?? []).map(async ({ key, block, ...curve }) => ({
    ...curve,
    column: named.get(key) ?? columns[0],
    rows: new Int32Array(await inflate(block)),
  })); // pages of earlier versions have none
  return {
    about,
    rows,
    kind: bytes.subarray(0, rows),
    stage: bytes.subarray(rows, 2 * rows),
    ids: bytes.subarray(2 * rows, (2 + half) * rows),
    columns,
    named,
    alone: await Promise.all(alone),
    mesh: about.refined_cells ? new Int32Array(await inflate(about.refined_cells.block)) : null,
    sides: about.sides ? await readSides(about.sides, rows) : null,
    replayed: new Map(about.replays.map((one, k) => /** @type {const} */ ([one.row, k])).filter(([row]) => row >= 0)),
  };
}

/** @type {(format: SidesFormat, rows: number) => Promise<Sides>} */
async function readSides({ block, ...format }, rows) {
  const bytes = new Uint8Array(await inflate(block));
  return { ...format, kinds: format.names.map((_, side) => bytes.subarray(side * rows, (side + 1) * rows)) };
}

/**
 * Decode the values of a column from its low bytes followed by its high bytes.
 * @type {(format: ColumnFormat, bytes: Uint8Array, rows: number) => Float64Array}
 */
export function readColumn(format, bytes, rows) {
  const values = new Float64Array(rows);
  const { levels, low = 0, step = 1, bend = 0, middle = 0 } = format;
  for (let k = 0; k < rows; k++) {
    const code = bytes[k] | (bytes[rows + k] << 8);
    if (code === MISSING) values[k] = NaN;
    else if (format.names) values[k] = code;
    else if (levels) values[k] = levels[code];
    else values[k] = bend ? middle + bend * Math.sinh(low + step * code) : low + step * code;
  }
  return values;
}

/** @type {(format: ColumnFormat, values: Float64Array) => Column} */
function makeColumn(format, values) {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (!(high >= low)) low = high = 0;
  const label = clipName(format.label);
  const title = format.unit ? `${label} [${format.unit}]` : label;
  const names = format.names ? format.names.map(clipName) : null;
  const path = format.path ?? ""; // pages of earlier versions have none
  const scale = columnScale({ diverges: format.diverges, names });
  const linear = format.diverges ? MARGIN_LINEAR : names ? 1 : linearRange(values);
  return { ...format, label, title, path, names, values, low, high, scale, linear };
}

/**
 * Range about zero within which a column's symlog scale is linear: a power of ten below most of its values.
 * @type {(values: Float64Array) => number}
 */
function linearRange(values) {
  const sizes = values
    .filter((value) => value !== 0 && Number.isFinite(value))
    .map(Math.abs)
    .sort();
  return sizes.length ? 10 ** Math.floor(Math.log10(sizes[Math.floor(SMALL_SHARE * sizes.length)])) : 1;
}

/**
 * First digits of a row's point id.
 * @type {(table: Table, row: number) => string}
 */
export function pointId(table, row) {
  const half = table.about.digits / 2;
  const bytes = table.ids.subarray(row * half, (row + 1) * half);
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * Decode the counts of a density by kind from their byte planes.
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
 * Find the replay nearest to a row, by distance in units of each parameter's range; different names count one. The row's
 * own replay comes first.
 * @param {Table} table
 * @param {number} row
 * @returns {number} number of the replay, -1 for none
 */
export function nearestReplay(table, row) {
  const own = table.replayed.get(row);
  if (own !== undefined) return own;
  let best = -1;
  let least = Infinity;
  const axes = table.columns.filter((column) => column.axis);
  for (const [other, number] of table.replayed) {
    let sum = table.kind[other] === table.kind[row] ? 0 : 1e-9; // breaks ties in favour of the same kind
    for (const { names, values, low, high } of axes) {
      const apart = names ? Number(values[row] !== values[other]) : (values[row] - values[other]) / (high - low || 1);
      sum += apart * apart || 0;
    }
    if (sum < least) [best, least] = [number, sum];
  }
  return best;
}

/**
 * Two-sample Kolmogorov-Smirnov distance of a column's values between two sets of rows, and whether it is significant at
 * 5 %. `order` holds the rows sorted by value.
 * @param {ArrayLike<number>} order
 * @param {ArrayLike<number>} values
 * @param {(row: number) => number} side 0 or 1 for the sets, anything else for neither
 * @returns {{ distance: number, significant: boolean, counts: [number, number] }}
 */
export function kolmogorovSmirnov(order, values, side) {
  /** @type {[number, number]} */
  const counts = [0, 0];
  for (let k = 0; k < order.length; k++) {
    const of = side(order[k]);
    if (of === 0 || of === 1) counts[of]++;
  }
  if (!counts[0] || !counts[1]) return { distance: 0, significant: false, counts };
  const seen = [0, 0];
  let distance = 0;
  for (let k = 0; k < order.length; k++) {
    const of = side(order[k]);
    if (of === 0 || of === 1) seen[of]++;
    if (k + 1 < order.length && values[order[k + 1]] === values[order[k]]) continue;
    distance = Math.max(distance, Math.abs(seen[0] / counts[0] - seen[1] / counts[1]));
  }
  const root = Math.sqrt((counts[0] * counts[1]) / (counts[0] + counts[1]));
  const rare = 1.358 / (root + 0.12 + 0.11 / root); // also for few rows (Stephens 1970)
  return { distance, significant: distance > rare, counts };
}

/**
 * Total variation distance of a column's names between two sets of rows, and whether it is significant at 5 % (chi-squared
 * test of homogeneity). It is to names what the Kolmogorov-Smirnov distance is to numbers.
 * @param {Column} column
 * @param {(row: number) => number} side 0 or 1 for the sets, anything else for neither
 * @returns {{ distance: number, significant: boolean, counts: [number, number] }}
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
  if (!counts[0] || !counts[1]) return { distance: 0, significant: false, counts };
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
  return { distance, significant: square > limit, counts };
}

/**
 * Distance between a parameter's distributions in two sets of rows, for numbers or names.
 * @type {(column: Column, order: (column: Column) => Uint32Array, side: (row: number) => number)
 *   => { distance: number, significant: boolean, counts: [number, number] }}
 */
export function distributionDistance(column, order, side) {
  return column.names ? nameDistance(column, side) : kolmogorovSmirnov(order(column), column.values, side);
}

/**
 * Rows sorted by a column's values, without missing ones.
 * @type {(column: Column) => Uint32Array}
 */
export function sortedRows(column) {
  const { values } = column;
  const rows = [];
  for (let row = 0; row < values.length; row++) if (!Number.isNaN(values[row])) rows.push(row);
  return Uint32Array.from(rows).sort((a, b) => values[a] - values[b] || a - b);
}

/**
 * Bin of each row of a column, of equal width along an axis.
 * @param {Column} column
 * @param {number} bins
 * @param {(value: number) => number} to the share of the axis
 * @returns {Uint8Array} 255 for none
 */
export function binRows({ values }, bins, to) {
  return Uint8Array.from(values, (value) =>
    Number.isNaN(value) ? 255 : clamp(Math.floor(to(value) * bins), 0, bins - 1),
  );
}

/**
 * The values of a column that are those of a grid, or its names' codes; sorted.
 * @type {(column: Column) => number[] | null}
 */
export function gridValues(column) {
  if (column.names) return column.names.map((_, code) => code);
  return column.axis && !column.drawn ? sortedValues(column) : null;
}

/**
 * The values of a column, each once, sorted.
 * @type {(column: Column) => number[]}
 */
export function sortedValues({ values }) {
  return [...new Set(values)].filter((value) => !Number.isNaN(value)).sort((a, b) => a - b);
}

/**
 * Range of a histogram: all values, or those between the 1st and 99th percentile if the others would crush it.
 * @type {(order: Uint32Array, column: Column) => [number, number]}
 */
export function clippedRange(order, { values, low, high }) {
  if (!order.length) return [low, high];
  const at = (/** @type {number} */ share) => values[order[Math.round(share * (order.length - 1))]];
  const [first, last] = [at(0.01), at(0.99)];
  const room = CLIPPED_FACTOR * (last - first);
  return [first - low > room ? first : low, high - last > room ? last : high];
}
