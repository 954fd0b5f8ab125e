// State of the page: filters, the rows that pass them, and the chosen row.

/** @import { Column, Table } from "./data.js" */
/** @typedef {{ low: number, high: number }} Range */
/** @typedef {{ column: Column, inverted: boolean }} LineAxis an axis of the parallel coordinates */

/**
 * @typedef {object} State
 * @property {Table} table
 * @property {Map<string, Range>} ranges by column
 * @property {Map<string, number>} fixed values of further axes in the map's slice
 * @property {Set<number>} hidden kinds
 * @property {Uint8Array} mask 1 for each row that passes
 * @property {LineAxis[]} lines axes of the parallel coordinates that the reader chose; empty for those of the page
 * @property {number} passing
 * @property {number} cursor the row under the pointer, -1 for none
 * @property {number} chosen the row that was clicked, -1 for none
 */

/** @type {(table: Table) => State} */
export function makeState(table) {
  const mask = new Uint8Array(table.rows).fill(1);
  const [ranges, fixed, hidden] = [new Map(), new Map(), new Set()];
  return { table, ranges, fixed, hidden, lines: [], mask, passing: table.rows, cursor: -1, chosen: -1 };
}

/**
 * Mark the rows that pass all filters, and return their number.
 * @type {(state: State) => number}
 */
export function applyFilters(state) {
  const { table, mask, hidden } = state;
  const shown = Uint8Array.from(table.about.kinds, (_, k) => (hidden.has(k) ? 0 : 1));
  for (let row = 0; row < table.rows; row++) mask[row] = shown[table.kind[row]];
  for (const [key, { low, high }] of state.ranges) {
    const values = table.named.get(key)?.values;
    if (!values) continue;
    for (let row = 0; row < table.rows; row++) if (!(values[row] >= low && values[row] <= high)) mask[row] = 0;
  }
  let passing = 0;
  for (let row = 0; row < table.rows; row++) passing += mask[row];
  state.passing = passing;
  return passing;
}

/**
 * Whether a row has the values at which the map's further axes are fixed.
 * @type {(state: State, row: number) => boolean}
 */
export function isInSlice({ table, fixed }, row) {
  for (const [key, value] of fixed) if (table.named.get(key)?.values[row] !== value) return false;
  return true;
}

/**
 * Remove all filters.
 * @param {State} state
 */
export function clearFilters({ ranges, hidden }) {
  ranges.clear();
  hidden.clear();
}

/**
 * Filter by a range of a column, or remove its filter.
 * @type {(state: State, key: string, range: Range | null) => void}
 */
export function setRange(state, key, range) {
  if (range) state.ranges.set(key, { low: Math.min(range.low, range.high), high: Math.max(range.low, range.high) });
  else state.ranges.delete(key);
}
