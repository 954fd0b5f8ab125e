// The page's state in its address, so that reloads and links keep it; and the filters as a condition of the command line.

/** @import { Table } from "./data.js" */
/** @import { Range, State } from "./selection.js" */

/**
 * @typedef {object} AddressState
 * @property {string} x
 * @property {string} y
 * @property {string} colour
 * @property {Map<string, Range>} ranges
 * @property {Map<string, number>} fixed values of further axes
 * @property {Set<number>} hidden kinds
 * @property {string} point first digits of a row's point id
 * @property {number | null} time s
 */

const RESERVED_KEYS = ["x", "y", "colour", "hide", "point", "time"];

/**
 * Parse the state in an address; columns and kinds that this study lacks are ignored.
 * @type {(table: Table, hash: string) => AddressState}
 */
export function parseAddress(table, hash) {
  const params = new URLSearchParams(hash.replace(/^#/, ""));
  const kinds = table.about.kinds.map(({ key }) => key);
  const hidden = (params.get("hide") ?? "").split(",").map((key) => kinds.indexOf(key));
  /** @type {Map<string, Range>} */
  const ranges = new Map();
  /** @type {Map<string, number>} */
  const fixed = new Map();
  for (const [key, text] of params) {
    if (RESERVED_KEYS.includes(key) || !table.named.has(key)) continue;
    const [low, high] = text.split("..").map(Number);
    if (low <= high) ranges.set(key, { low, high });
    else if (text.startsWith("@")) fixed.set(key, Number(text.slice(1)));
  }
  const time = Number(params.get("time") ?? NaN);
  return {
    x: params.get("x") ?? "",
    y: params.get("y") ?? "",
    colour: params.get("colour") ?? "",
    ranges,
    fixed,
    hidden: new Set(hidden.filter((kind) => kind >= 0)),
    point: params.get("point") ?? "",
    time: Number.isFinite(time) ? time : null,
  };
}

/**
 * Format the page's state as the end of its address.
 * @param {Table} table
 * @param {State} state
 * @param {{ x: string, y: string, colour: string, point: string, time: number | null }} now
 * @returns {string} with its #
 */
export function formatAddress(table, state, { x, y, colour, point, time }) {
  const params = new URLSearchParams({ x, y, colour });
  for (const [key, { low, high }] of state.ranges) params.append(key, `${low}..${high}`);
  for (const [key, value] of state.fixed) params.append(key, `@${value}`);
  if (state.hidden.size) params.set("hide", [...state.hidden].map((kind) => table.about.kinds[kind].key).join());
  if (point) params.set("point", point);
  if (time !== null) params.set("time", time.toFixed(2));
  return `#${params}`;
}

/**
 * Format the filters as a condition for the commands' `--where`; empty without filters.
 * @type {(table: Table, state: State) => string}
 */
export function formatCondition(table, state) {
  const parts = [];
  for (const [key, { low, high }] of state.ranges) {
    const names = table.named.get(key)?.names?.filter((_, code) => code >= low && code <= high);
    if (names) parts.push(`${key} in [${names.map((name) => JSON.stringify(name)).join(", ")}]`);
    else parts.push(`${key} >= ${low}`, `${key} <= ${high}`);
  }
  for (const kind of state.hidden) {
    const { key, outcome } = table.about.kinds[kind];
    parts.push(outcome === "success" ? 'outcome != "success"' : `cause != ${JSON.stringify(key)}`);
  }
  return parts.join(" and ");
}
