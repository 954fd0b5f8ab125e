// What is looked at, as the end of the page's address and as a condition of the command line: reloads and links keep it.

/** @import { Table } from "./data.js" */
/** @import { Range, State } from "./selection.js" */

/**
 * @typedef {object} Wanted
 * @property {string} x
 * @property {string} y
 * @property {string} colour
 * @property {Map<string, Range>} ranges
 * @property {Map<string, number>} fixed values of further axes
 * @property {Set<number>} hidden kinds
 * @property {string} point the beginning of a row's id
 * @property {number | null} time s
 */

const OWN = ["x", "y", "colour", "hide", "point", "time"];

/**
 * What an address asks for; of what this study lacks, nothing.
 * @type {(table: Table, hash: string) => Wanted}
 */
export function wantedOf(table, hash) {
  const told = new URLSearchParams(hash.replace(/^#/, ""));
  const kinds = table.about.kinds.map(({ key }) => key);
  const hidden = (told.get("hide") ?? "").split(",").map((key) => kinds.indexOf(key));
  /** @type {Map<string, Range>} */
  const ranges = new Map();
  /** @type {Map<string, number>} */
  const fixed = new Map();
  for (const [key, text] of told) {
    if (OWN.includes(key) || !table.named.has(key)) continue;
    const [low, high] = text.split("..").map(Number);
    if (low <= high) ranges.set(key, { low, high });
    else if (text.startsWith("@")) fixed.set(key, Number(text.slice(1)));
  }
  const time = Number(told.get("time") ?? NaN);
  return {
    x: told.get("x") ?? "",
    y: told.get("y") ?? "",
    colour: told.get("colour") ?? "",
    ranges,
    fixed,
    hidden: new Set(hidden.filter((kind) => kind >= 0)),
    point: told.get("point") ?? "",
    time: Number.isFinite(time) ? time : null,
  };
}

/**
 * The address of what is looked at.
 * @param {Table} table
 * @param {State} state
 * @param {{ x: string, y: string, colour: string, point: string, time: number | null }} now
 * @returns {string} with its #
 */
export function addressOf(table, state, { x, y, colour, point, time }) {
  const told = new URLSearchParams({ x, y, colour });
  for (const [key, { low, high }] of state.ranges) told.append(key, `${low}..${high}`);
  for (const [key, value] of state.fixed) told.append(key, `@${value}`);
  if (state.hidden.size) told.set("hide", [...state.hidden].map((kind) => table.about.kinds[kind].key).join());
  if (point) told.set("point", point);
  if (time !== null) told.set("time", time.toFixed(2));
  return `#${told}`;
}

/**
 * The filters as `--where` of the commands takes them; empty without any.
 * @type {(table: Table, state: State) => string}
 */
export function conditionOf(table, state) {
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
