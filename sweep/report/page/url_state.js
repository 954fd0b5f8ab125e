// The page's state in its address, so that reloads and links keep it; and the filters as a condition of the command line.

import { allowedScales, columnScale } from "./axes.js";

/** @import { ScaleKind } from "./axes.js" */
/** @import { Table } from "./data.js" */
/** @import { LineAxis, Range, State } from "./selection.js" */

/**
 * @typedef {object} AddressState
 * @property {string} x
 * @property {string} y
 * @property {string} colour
 * @property {Map<string, Range>} ranges
 * @property {Map<string, number>} fixed values of further axes
 * @property {Set<number>} hidden kinds
 * @property {Map<string, ScaleKind>} scales of columns whose scale the reader chose
 * @property {LineAxis[]} lines axes of the parallel coordinates that the reader chose; empty for those of the page
 * @property {string} point first digits of a row's point id
 * @property {number | null} time s
 * @property {[number, number] | null} span part of the time that the plots over time show, s
 */

const RESERVED_KEYS = ["x", "y", "colour", "hide", "scale", "line", "point", "time", "span"];

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
  const scales = params.getAll("scale").flatMap((text) => {
    const [key, kind] = splitAtLast(text, ":");
    const column = table.named.get(key);
    const scale = column && allowedScales(column).find((one) => one === kind);
    return scale ? [/** @type {const} */ ([key, scale])] : [];
  });
  const lines = params.getAll("line").flatMap((text) => {
    const [key, way] = splitAtLast(text, ":");
    const column = table.named.get(key);
    return column ? [{ column, inverted: way === "inverted" }] : [];
  });
  const time = Number(params.get("time") ?? NaN);
  const [from, until] = (params.get("span") ?? "").split("..").map(Number);
  return {
    x: params.get("x") ?? "",
    y: params.get("y") ?? "",
    colour: params.get("colour") ?? "",
    ranges,
    fixed,
    hidden: new Set(hidden.filter((kind) => kind >= 0)),
    scales: new Map(scales),
    lines: lines.length > 1 ? lines : [],
    point: params.get("point") ?? "",
    time: Number.isFinite(time) ? time : null,
    span: from >= 0 && until > from && until < Infinity ? [from, until] : null,
  };
}

/**
 * Split a text at the last place of a sign, as names of columns may have the sign, too.
 * @type {(text: string, sign: string) => [string, string]}
 */
function splitAtLast(text, sign) {
  const at = text.lastIndexOf(sign);
  return at < 0 ? [text, ""] : [text.slice(0, at), text.slice(at + 1)];
}

/**
 * Format the page's state as the end of its address.
 * @param {Table} table
 * @param {State} state
 * @param {{ x: string, y: string, colour: string, point: string, time: number | null, span: [number, number] | null }} now
 * @returns {string} with its #
 */
export function formatAddress(table, state, { x, y, colour, point, time, span }) {
  const params = new URLSearchParams({ x, y, colour });
  for (const [key, { low, high }] of state.ranges) params.append(key, `${low}..${high}`);
  for (const [key, value] of state.fixed) params.append(key, `@${value}`);
  if (state.hidden.size) params.set("hide", [...state.hidden].map((kind) => table.about.kinds[kind].key).join());
  for (const column of table.columns)
    if (column.scale !== columnScale(column)) params.append("scale", `${column.key}:${column.scale}`);
  for (const { column, inverted } of state.lines)
    params.append("line", `${column.key}:${inverted ? "inverted" : "upright"}`);
  if (point) params.set("point", point);
  if (time !== null) params.set("time", time.toFixed(2));
  if (span) params.set("span", span.map((end) => end.toFixed(2)).join(".."));
  return `#${params}`;
}

/**
 * Format the filters as a condition for the commands' `--where`, without those by columns of the page alone; empty without
 * filters.
 * @type {(table: Table, state: State) => string}
 */
export function formatCondition(table, state) {
  const parts = [];
  for (const [key, { low, high }] of state.ranges) {
    if (table.named.get(key)?.derived) continue;
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
