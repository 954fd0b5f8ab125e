// Overlays of the map: outlines, analytic limits, the line of zero margin, rings.
import { pointInBox } from "./axes.js";
import { zeroLines } from "./contour.js";
import { clipName } from "./data.js";
import { cssColour, drawLine } from "./dom.js";
import { rowPosition } from "./map_fill.js";
import { clamp } from "./numbers.js";

/** @import { Box } from "./axes.js" */
/** @import { PlacedRows } from "./cells.js" */
/** @import { Column, Region } from "./data.js" */
/** @import { App } from "./main.js" */

const LINE = 16; // pixels from one line of text to the next
const DASHES = [
  [7, 4],
  [7, 3, 2, 3],
  [2, 3],
]; // dash patterns of limits in turn

/**
 * Draw outlines of a refined map's cells.
 * @type {(app: App, pen: CanvasRenderingContext2D, here: PlacedRows, area: Box) => void}
 */
export function drawOutlines(app, pen, here, area) {
  const { outlines } = here;
  if (!outlines.length) return;
  pen.strokeStyle = cssColour(app.theme().dark ? [255, 255, 255] : [0, 0, 0], 0.22);
  pen.lineWidth = 0.5;
  pen.beginPath();
  for (let k = 0; k < outlines.length; k += 4) {
    const [left, low, right, high] = outlines.subarray(k, k + 4);
    pen.rect(
      area.left + left * area.width,
      area.top + (1 - high) * area.height,
      (right - left) * area.width,
      (high - low) * area.height,
    );
  }
  pen.stroke();
}

/**
 * Draw the line of zero margin.
 * @type {(app: App, pen: CanvasRenderingContext2D, x: Column, y: Column, here: PlacedRows, area: Box) => void}
 */
export function drawZeroMargin(app, pen, x, y, here, area) {
  pen.strokeStyle = app.theme().ink;
  pen.lineWidth = 1;
  pen.setLineDash([5, 3]);
  const { left, top, width, height } = area;
  const [across, down] = [left + here.x.to(0) * width, top + (1 - here.y.to(0)) * height];
  if (x.diverges && across > left && across < left + width) drawLine(pen, across, top, across, top + height);
  if (y.diverges && down > top && down < top + height) drawLine(pen, left, down, left + width, down);
  pen.setLineDash([]);
}

/**
 * Draw the zero contour of the metric that gives the map its colours.
 * @type {(app: App, pen: CanvasRenderingContext2D, here: PlacedRows, column: Column, area: Box) => void}
 */
export function drawContour(app, pen, here, column, area) {
  const lines = zeroLines(here, (row) => column.values[row]);
  pen.lineCap = "round";
  drawSegments(app, pen, lines, area, [4, 1.8]);
  pen.lineCap = "butt";
}

/**
 * Draw straight lines that stand out from any background.
 * @param {App} app
 * @param {CanvasRenderingContext2D} pen
 * @param {ArrayLike<number>} lines from x, from y, to x, to y of each in turn, as shares of the axes
 * @param {Box} area
 * @param {[number, number]} widths of their outline, and of the lines themselves
 */
export function drawSegments(app, pen, lines, area, widths) {
  drawOutlinedLine(app, pen, app.theme().ink, widths, () => {
    for (let k = 0; k < lines.length; k += 4) {
      pen.moveTo(...pointInBox(area, lines[k], lines[k + 1]));
      pen.lineTo(...pointInBox(area, lines[k + 2], lines[k + 3]));
    }
  });
}

/**
 * Outlines of the certified region over two columns, as points whose first number belongs to the horizontal axis.
 * @type {(region: Region, x: string, y: string) => [number, number][][]}
 */
export function regionLines({ outlines }, x, y) {
  return outlines.flatMap((one) => {
    const turned = one.x === y && one.y === x;
    if (!turned && (one.x !== x || one.y !== y)) return [];
    const spot = (/** @type {number[]} */ line, /** @type {number} */ k) =>
      /** @type {[number, number]} */ (turned ? [line[k + 1], line[k]] : [line[k], line[k + 1]]);
    return one.lines.map((line) => Array.from({ length: line.length / 2 }, (_, k) => spot(line, 2 * k)));
  });
}

/**
 * Draw the outline of the certified region.
 * @type {(app: App, pen: CanvasRenderingContext2D, x: Column, y: Column, here: PlacedRows, area: Box) => void}
 */
export function drawCertifiedRegion(app, pen, x, y, here, area) {
  const { region } = app.table.about;
  if (!region) return;
  drawOutlinedLine(app, pen, app.theme().ink, [5, 2.4], () => {
    for (const line of regionLines(region, x.key, y.key))
      line.forEach(([u, v], k) => {
        const spot = pointInBox(area, clamp(here.x.to(u), 0, 1), clamp(here.y.to(v), 0, 1));
        if (k) pen.lineTo(...spot);
        else pen.moveTo(...spot);
      });
  });
}

/** @typedef {{ left: number, size: number, up: number }} Label */

/**
 * Whether two labels do not overlap.
 * @type {(one: Label, other: Label) => boolean}
 */
const areApart = (one, other) =>
  Math.abs(one.up - other.up) >= 2 * LINE || one.left >= other.left + other.size || other.left >= one.left + one.size;

/**
 * Draw analytic limits as dashed curves, each with its name along it where there is room.
 * @type {(app: App, pen: CanvasRenderingContext2D, x: Column, y: Column, here: PlacedRows, area: Box) => void}
 */
export function drawAnalyticLimits(app, pen, x, y, here, area) {
  const curves = app.table.about.theory.filter(
    (one) => [x.key, y.key].sort().join() === [one.of, one.along].sort().join(),
  );
  pen.save();
  pen.beginPath();
  pen.rect(area.left, area.top, area.width, area.height);
  pen.clip();
  /** @type {Label[]} those that stand already */
  const named = [];
  curves.forEach((curve, number) => {
    const spots = curve.at.flatMap((along, k) => {
      const limit = curve.limit[k];
      if (along === null || limit === null) return [];
      const [u, v] = curve.of === x.key ? [limit, along] : [along, limit];
      return [pointInBox(area, here.x.to(u), here.y.to(v))];
    });
    pen.setLineDash(DASHES[number % DASHES.length]);
    drawOutlinedLine(app, pen, app.theme().ink, [5, 2], () => spots.forEach(([u, v]) => pen.lineTo(u, v)));
    pen.setLineDash([]);
    const name = clipName(curve.label);
    const size = pen.measureText(name).width;
    const places = spots
      .filter(
        ([u, v]) => u > area.left && u < area.left + area.width - 8 && v > area.top + 8 && v < area.top + area.height,
      )
      .map(([u, v]) => ({
        left: u + 8 + size > area.left + area.width ? u - 8 - size : u + 8,
        size,
        up: Math.max(v - 4, area.top + 18),
      }))
      .reverse();
    const free = places.find((here) => named.every((one) => areApart(here, one))) ?? places[0];
    if (!free) return;
    named.push(free);
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.lineWidth = 4;
    pen.strokeStyle = app.theme().panel;
    pen.fillStyle = app.theme().ink;
    pen.strokeText(name, free.left, free.up);
    pen.fillText(name, free.left, free.up);
  });
  pen.restore();
}

/**
 * Draw rings around the chosen row and the one under the pointer.
 * @type {(app: App, pen: CanvasRenderingContext2D, here: PlacedRows, area: Box) => void}
 */
export function drawPointedRows(app, pen, here, area) {
  const { chosen, cursor } = app.state;
  for (const [row, size] of [
    [chosen, 8],
    [cursor, 6],
  ]) {
    const k = row < 0 ? -1 : here.rows.indexOf(row);
    if (k >= 0) drawRing(app, pen, rowPosition(here, k, area), size, app.theme().accent, [4, 2]);
  }
}

/**
 * Draw a ring that stands out from any background.
 * @param {App} app
 * @param {CanvasRenderingContext2D} pen
 * @param {[number, number]} spot
 * @param {number} size
 * @param {string} colour
 * @param {[number, number]} widths of its outline, and of the line itself
 */
export function drawRing(app, pen, [u, v], size, colour, widths) {
  drawOutlinedLine(app, pen, colour, widths, () => pen.arc(u, v, size, 0, 2 * Math.PI));
}

/**
 * Draw a line that stands out from any background.
 * @param {App} app
 * @param {CanvasRenderingContext2D} pen
 * @param {string} colour
 * @param {[number, number]} widths of its outline, and of the line itself
 * @param {() => void} path
 */
export function drawOutlinedLine(app, pen, colour, [around, own], path) {
  pen.beginPath();
  path();
  [pen.strokeStyle, pen.lineWidth] = [app.theme().panel, around];
  pen.stroke();
  [pen.strokeStyle, pen.lineWidth] = [colour, own];
  pen.stroke();
}
