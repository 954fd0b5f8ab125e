// Filling of a map: cells, marks or densities, in the colours of kinds, rates or metrics.
import { pointInBox } from "./axes.js";
import { arcsinh, clamp, mixColours, packRgb, scaleColour } from "./numbers.js";
import { cssColour } from "./dom.js";
import { fillKindCell, fillMark } from "./marks.js";
import { fillCell, makeGlyph, paintKind, drawStamp, makeStamp, rowNear } from "./raster.js";

/** @import { Box } from "./axes.js" */
/** @import { PlacedRows } from "./cells.js" */
/** @import { Binned, Column } from "./data.js" */
/** @import { Rgb } from "./dom.js" */
/** @import { App } from "./main.js" */
/** @import { Edges, Pixels } from "./raster.js" */

export const KIND = "kind";
export const RATE = "rate";
const GAPPED = 6; // CSS pixels of a cell from which it has a gap
export const GLYPHED = 13; // CSS pixels of a cell from which it has a glyph
const [HALO_RADIUS, HALO_OPACITY] = [2.4, 0.7]; // CSS pixels of a mark's radius from which it has a halo
const FADED_SHARE = 0.86; // by which rows that do not pass the filters fade

/**
 * Position of a row on the map, in CSS pixels.
 * @type {(here: PlacedRows, k: number, area: Box) => [number, number]}
 */
export function rowPosition(here, k, area) {
  const [left, low, right, high] = here.boxes.subarray(4 * k, 4 * k + 4);
  const [x, y] = here.form === "cells" ? [(left + right) / 2, (low + high) / 2] : [left, low];
  return pointInBox(area, x, y);
}

/**
 * Row that a painted map shows at a point in CSS pixels, -1 for none.
 * @type {(pixels: Pixels | null, here: PlacedRows | null, area: Box, point: [number, number]) => number}
 */
export function rowAtPoint(pixels, here, { left, top, width, height }, [x, y]) {
  if (!pixels || x < left || x > left + width || y < top || y > top + height) return -1;
  const ratio = pixels.width / width;
  const reach = ratio * (here?.form === "marks" ? 6 : 1); // bridges the lines between cells
  return rowNear(pixels, (x - left) * ratio, (y - top) * ratio, reach);
}

/**
 * Radius of marks in CSS pixels.
 * @type {(here: PlacedRows) => number}
 */
export function markSize(here) {
  return clamp(70 / Math.sqrt(here.rows.length + 1) + 1.2, 1.7, 5);
}

/**
 * Ends of a colour scale: the central 98 % of the values.
 * @type {(column: Column) => [number, number]}
 */
export function colourRange(column) {
  const values = column.values.filter((value) => !Number.isNaN(value)).sort();
  if (!values.length) return [0, 1];
  const at = (/** @type {number} */ share) => values[Math.round(share * (values.length - 1))];
  const [low, high] = [at(0.01), at(0.99)];
  return high > low ? [low, high] : [column.low, column.high || column.low + 1];
}

/**
 * Make the colour of a row by a column, a packed number; null for the colours of kinds.
 * @type {(app: App, here: PlacedRows, by: string) => ((k: number) => number) | null}
 */
function makeRowColour({ table, state }, here, by) {
  if (by === KIND) return null;
  if (by === RATE) {
    const size = here.cell.reduce((most, one) => Math.max(most, one), 0) + 1;
    const [good, all] = [new Int32Array(size), new Int32Array(size)];
    here.rows.forEach((row, k) => {
      const { outcome } = table.about.kinds[table.kind[row]];
      const cell = here.cell[k] ?? 0;
      if (!state.mask[row] || outcome === "invalid") return;
      all[cell]++;
      if (outcome === "success") good[cell]++;
    });
    return (k) => (all[here.cell[k] ?? 0] ? scaleColour(good[here.cell[k] ?? 0] / all[here.cell[k] ?? 0]) : 0);
  }
  const column = table.named.get(by);
  if (!column) return null;
  const [low, high] = colourRange(column);
  const most = arcsinh(Math.max(-low, high), column.linear);
  return (k) => {
    const value = column.values[here.rows[k]];
    if (Number.isNaN(value)) return 0;
    return column.diverges
      ? scaleColour(0.5 + arcsinh(value, column.linear) / most / 2, true)
      : scaleColour((value - low) / (high - low));
  };
}

/**
 * A cell of the map: its row, its edges in pixels, and what fills it: the look of a kind, or a packed colour.
 * @typedef {object} PlacedCell
 * @property {number} row
 * @property {Edges} box
 * @property {boolean} glyphed whether it has room for a glyph
 * @property {number} kind -1 for a cell of one colour
 * @property {number} colour
 */

/**
 * Call a function with each cell.
 * @param {App} app
 * @param {PlacedRows} here
 * @param {string} by
 * @param {{ width: number, height: number }} size of the map, in pixels
 * @param {number} ratio pixels for each CSS pixel
 * @param {(cell: PlacedCell) => void} use
 */
function forEachCell(app, here, by, { width, height }, ratio, use) {
  const { table, state } = app;
  const { paper } = app.theme();
  const faded = app.looks().map((look) => packRgb(...mixColours(look.cell, paper, FADED_SHARE)));
  const colour = makeRowColour(app, here, by);
  const gap = here.outlines.length ? 0 : 1;
  const empty = packRgb(...mixColours(paper, [128, 128, 128], 0.12));
  for (let k = 0; k < here.rows.length; k++) {
    const row = here.rows[k];
    const kind = table.kind[row];
    const left = Math.round(here.boxes[4 * k] * width);
    const right = Math.max(left + 1, Math.round(here.boxes[4 * k + 2] * width));
    const top = Math.round((1 - here.boxes[4 * k + 3]) * height);
    const bottom = Math.max(top + 1, Math.round((1 - here.boxes[4 * k + 1]) * height));
    const least = Math.min(right - left, bottom - top) / ratio;
    const space = least >= GAPPED ? gap : 0;
    const box = { left, top, right: right - space, bottom: bottom - space };
    const passes = state.mask[row] > 0;
    const shown = colour ? (passes && colour(k)) || empty : faded[kind];
    use({ row, box, glyphed: least >= GLYPHED, kind: passes && !colour ? kind : -1, colour: shown });
  }
}

/** @type {(app: App, pixels: Pixels, here: PlacedRows, by: string, ratio: number) => void} */
export function paintCells(app, pixels, here, by, ratio) {
  const looks = app.looks();
  const glyphs = looks.map((look) => makeGlyph(look, ratio));
  forEachCell(app, here, by, pixels, ratio, ({ row, box, glyphed, kind, colour }) => {
    if (kind >= 0) paintKind(pixels, box, looks[kind], glyphed ? glyphs[kind] : null, row, ratio);
    else fillCell(pixels, box.left, box.top, box.right, box.bottom, colour, row, null, 0, ratio);
  });
}

/**
 * Draw cells as paths.
 * @type {(app: App, pen: CanvasRenderingContext2D, here: PlacedRows, by: string, area: Box) => void}
 */
export function drawVectorCells(app, pen, here, by, area) {
  const looks = app.looks();
  forEachCell(app, here, by, area, 1, ({ box, glyphed, kind, colour }) => {
    const [x, y] = [area.left + box.left, area.top + box.top];
    const [width, height] = [box.right - box.left, box.bottom - box.top];
    if (kind >= 0) return fillKindCell(pen, x, y, width, height, looks[kind], glyphed);
    pen.fillStyle = cssColour([colour & 255, (colour >> 8) & 255, (colour >> 16) & 255]);
    pen.fillRect(x, y, width, height);
  });
}

/**
 * A mark of the map: a row with its place, as shares of the map's size, and its look.
 * @typedef {object} PlacedMark
 * @property {number} row
 * @property {number} kind
 * @property {number} across
 * @property {number} up
 * @property {boolean} passes whether the row passes the filters
 * @property {Rgb} rgb
 * @property {number} opacity
 */

/**
 * Call a function with each mark, those that do not pass the filters first.
 * @type {(app: App, here: PlacedRows, by: string, use: (mark: PlacedMark) => void) => void}
 */
function forEachMark(app, here, by, use) {
  const { table, state } = app;
  const { paper } = app.theme();
  const looks = app.looks();
  const colour = makeRowColour(app, here, by);
  const opacity = clamp(120 / Math.sqrt(here.rows.length + 1), 0.55, 1);
  const faint = looks.map((look) => mixColours(look.mark, paper, FADED_SHARE));
  for (const passes of [false, true])
    here.rows.forEach((row, k) => {
      if (state.mask[row] > 0 !== passes) return;
      const kind = table.kind[row];
      const packed = colour ? colour(k) : 0;
      const own = packed
        ? /** @type {Rgb} */ ([packed & 255, (packed >> 8) & 255, (packed >> 16) & 255])
        : looks[kind].mark;
      const [across, up] = here.boxes.subarray(4 * k, 4 * k + 2);
      use({ row, kind, across, up, passes, rgb: passes ? own : faint[kind], opacity: passes ? opacity : 0.5 });
    });
}

/** @type {(app: App, pixels: Pixels, here: PlacedRows, by: string, ratio: number) => void} */
export function paintMarks(app, pixels, here, by, ratio) {
  const { paper } = app.theme();
  const looks = app.looks();
  const radius = markSize(here) * ratio;
  const stamps = looks.map((look) => makeStamp(look.shape, radius));
  const halos = radius > HALO_RADIUS * ratio ? looks.map((look) => makeStamp(look.shape, radius + ratio)) : null;
  forEachMark(app, here, by, ({ row, kind, across, up, passes, rgb, opacity }) => {
    const [x, y] = [across * pixels.width, (1 - up) * pixels.height];
    if (passes && halos) drawStamp(pixels, halos[kind], x, y, paper, HALO_OPACITY, -2);
    drawStamp(pixels, stamps[kind], x, y, rgb, opacity, passes ? row : -2);
  });
}

/**
 * Draw the marks as paths.
 * @type {(app: App, pen: CanvasRenderingContext2D, here: PlacedRows, by: string, area: Box) => void}
 */
export function drawVectorMarks(app, pen, here, by, area) {
  const { paper } = app.theme();
  const looks = app.looks();
  const radius = markSize(here);
  forEachMark(app, here, by, ({ kind, across, up, passes, rgb, opacity }) => {
    const [x, y] = pointInBox(area, across, up);
    const { shape } = looks[kind];
    if (passes && radius > HALO_RADIUS) fillMark(pen, shape, x, y, radius + 1, paper, HALO_OPACITY);
    fillMark(pen, shape, x, y, radius, rgb, opacity);
  });
}

/**
 * Paint counts as colours: kinds mixed in proportion, stronger for more rollouts.
 * @type {(app: App, pixels: Pixels, here: PlacedRows, density: Binned, counts: Uint32Array, faint: boolean) => void}
 */
export function paintDensity(app, pixels, here, density, counts, faint) {
  const { wide, high } = density;
  const looks = app.looks();
  const { paper } = app.theme();
  const size = wide * high;
  const [across, up] = /** @type {const} */ ([
    [here.x, density.x_ends],
    [here.y, density.y_ends],
  ]).map(
    ([scale, ends]) =>
      (/** @type {number} */ share) =>
        scale.to(ends[0] + share * (ends[1] - ends[0])),
  );
  const totals = new Float64Array(size);
  for (let k = 0; k < counts.length; k++) totals[k % size] += counts[k];
  const most = totals.reduce((a, b) => Math.max(a, b), 0);
  for (let cell = 0; cell < size; cell++) {
    if (!totals[cell]) continue;
    /** @type {Rgb} */
    let rgb = [0, 0, 0];
    looks.forEach((look, kind) => {
      const share = counts[kind * size + cell] / totals[cell];
      rgb = [rgb[0] + look.cell[0] * share, rgb[1] + look.cell[1] * share, rgb[2] + look.cell[2] * share];
    });
    const strength = (0.35 + 0.65 * (Math.log1p(totals[cell]) / Math.log1p(most))) * (faint ? 0.25 : 1);
    const [i, j] = [cell % wide, Math.floor(cell / wide)];
    const [left, right] = [i, i + 1].map((k) => Math.round(across(k / wide) * pixels.width));
    const [bottom, top] = [j, j + 1].map((k) => Math.round((1 - up(k / high)) * pixels.height));
    fillCell(pixels, left, top, right, bottom, packRgb(...mixColours(paper, rgb, strength)), -1, null, 0, 1);
  }
}
