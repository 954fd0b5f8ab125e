// Maps of the same points for two studies, or for several policies, beside each other.
import { axisTitle, chartBox, drawFrame } from "./axes.js";
import { placeRows } from "./cells.js";
import { drawKindBox } from "./charts.js";
import { clipName } from "./data.js";
import { byId, element, kindStyle, placeTip, pointerPosition, prepareCanvas, shortenToFit } from "./dom.js";
import { KIND, markSize, paintCells, paintMarks, rowAtPoint, rowPosition } from "./map_fill.js";
import { drawPointedRows, drawSegments } from "./map_overlays.js";
import { formatCount, packRgb } from "./numbers.js";
import { makePixels } from "./raster.js";
import { isInSlice } from "./selection.js";

/** @import { PlacedRows } from "./cells.js" */
/** @import { Kind, Sides, Table } from "./data.js" */
/** @import { App, View } from "./main.js" */
/** @import { Pixels } from "./raster.js" */

const SIDE_MARGIN = { left: 56, right: 10, top: 26, bottom: 46 };
const FLIP_WIDTHS = /** @type {[number, number]} */ ([3.4, 1.5]); // of the outline around flips, and of its line

/**
 * One of the maps.
 * @typedef {object} SideMap
 * @property {App} own the page, with the outcomes of this side as kinds
 * @property {string} title
 * @property {Uint8Array} flips
 * @property {HTMLCanvasElement} base
 * @property {HTMLCanvasElement} over
 * @property {HTMLElement} plot
 * @property {Pixels | null} pixels
 */

/** @type {(app: App, sides: Sides) => View} */
export function sidesView(app, sides) {
  const { table, state } = app;
  const root = byId("sides");
  /** @type {PlacedRows | null} */
  let places = null;
  let placed = ""; // columns and slice that `places` are of
  const maps = sides.kinds.map((kind, side) => makeMap(kind, sideTitle(table, sides, side), flippedRows(sides, side)));
  const tip = element("div", { class: "tip", hidden: "" });
  root.replaceChildren(...maps.map(({ plot }) => plot), tip);
  const swatches = makeKey(sides);

  /** @type {(kind: Uint8Array, title: string, flips: Uint8Array) => SideMap} */
  function makeMap(kind, title, flips) {
    const label = `Map of the outcomes. ${title}.`;
    const own = {
      ...app,
      table: { ...table, kind, about: { ...table.about, kinds: sides.styles } },
      looks: () => sides.styles.map((style) => kindStyle(style, app.theme())),
    };
    const base = element("canvas", { role: "img", "aria-label": label });
    const over = element("canvas", { class: "over", "aria-hidden": "true" });
    const plot = element("div", { class: "plot side" }, base, over);
    const map = /** @type {SideMap} */ ({ own, title, flips, base, over, plot, pixels: null });
    over.addEventListener("pointermove", (event) => show(map, rowAt(map, pointerPosition(event, over))));
    over.addEventListener("pointerleave", (event) => event.pointerType !== "touch" && show(map, -1));
    over.addEventListener("click", (event) => {
      const row = rowAt(map, pointerPosition(event, over));
      if (row < 0) return;
      show(map, row);
      app.choose(row);
    });
    return map;
  }

  const boxOf = (/** @type {SideMap} */ { base }) => chartBox(base, SIDE_MARGIN);

  const columns = () =>
    ["map-x", "map-y"].map((id) => {
      const { value } = /** @type {HTMLSelectElement} */ (byId(id));
      return table.named.get(value) ?? table.columns[0];
    });

  const lay = () => {
    const [x, y] = columns();
    const wanted = JSON.stringify([x.key, y.key, ...state.fixed, x.scale, y.scale, maps[0].base.clientWidth]);
    if (places && placed === wanted) return places;
    placed = wanted;
    places = placeRows(table, x, y, (row) => isInSlice(state, row), boxOf(maps[0]).width / 70);
    return places;
  };

  const draw = () => {
    const here = lay();
    const [x, y] = columns();
    for (const map of maps) {
      const sheet = prepareCanvas(map.base);
      const area = boxOf(map);
      const { pen, ratio } = sheet;
      const pixels = makePixels(Math.round(area.width * ratio), Math.round(area.height * ratio));
      pixels.colours.fill(packRgb(...app.theme().paper));
      map.pixels = pixels;
      if (here.form === "cells") paintCells(map.own, pixels, here, KIND, ratio);
      else paintMarks(map.own, pixels, here, KIND, ratio);
      pen.putImageData(pixels.image, Math.round(area.left * ratio), Math.round(area.top * ratio));
      const shown = (/** @type {number} */ row) => map.flips[row] > 0 && state.mask[row] > 0;
      if (here.form === "cells") {
        drawSegments(app, pen, boundaryEdges(here, shown), area, FLIP_WIDTHS);
      } else {
        [pen.strokeStyle, pen.lineWidth] = [app.theme().ink, 0.9];
        here.rows.forEach((row, k) => {
          if (!shown(row)) return;
          pen.beginPath();
          pen.arc(...rowPosition(here, k, area), markSize(here) + 1.2, 0, 2 * Math.PI);
          pen.stroke();
        });
      }
      pen.fillStyle = app.theme().ink;
      pen.textAlign = "left";
      pen.textBaseline = "top";
      pen.font = pen.font.replace(/\d+px/, "bold 13px");
      pen.fillText(shortenToFit(pen, map.title, sheet.width - area.left), area.left, 5);
      pen.font = pen.font.replace(/bold 13px/, "12px");
      drawFrame(
        sheet,
        app.theme(),
        area,
        { scale: here.x, title: axisTitle(x, here.x) },
        { scale: here.y, title: axisTitle(y, here.y) },
      );
    }
    drawKey();
    point();
  };

  const drawKey = () =>
    swatches.forEach((swatch, k) => {
      const sheet = prepareCanvas(swatch);
      drawKindBox(sheet.pen, 0, 0, sheet.width, sheet.height, maps[0].own.looks()[k], sheet.ratio);
    });

  /** The row under the pointer, and the chosen one, on all maps. */
  const point = () => {
    for (const map of maps) {
      const { pen } = prepareCanvas(map.over);
      if (places) drawPointedRows(app, pen, places, boxOf(map));
    }
  };

  /** @type {(map: SideMap, at: [number, number]) => number} */
  const rowAt = (map, at) => rowAtPoint(map.pixels, places, boxOf(map), at);

  /** @type {(map: SideMap, row: number) => void} */
  const show = (map, row) => {
    app.point(row);
    tip.hidden = row < 0;
    const k = row < 0 || !places ? -1 : places.rows.indexOf(row);
    if (k < 0 || !places) return;
    const { plot } = map;
    tip.replaceChildren(...app.words(row, columns()));
    const [u, v] = rowPosition(places, k, boxOf(map));
    placeTip(tip, plot.offsetLeft + u, plot.offsetTop + v);
  };

  return { root, draw, point };
}

/**
 * Whether a side's rollout succeeds and that of the other one fails, or the reverse. The other one of two is the other; of
 * several it is the first.
 * @type {(sides: Sides, side: number) => Uint8Array}
 */
function flippedRows({ kinds, styles }, side) {
  const other = kinds[side || kinds.length > 2 ? 0 : 1];
  return Uint8Array.from(kinds[side], (kind, row) => {
    const both = [styles[kind].outcome, styles[other[row]].outcome];
    return Number(both.includes("success") && both.includes("failure"));
  });
}

/**
 * Heading of a side's map: its name and how many of its valid rollouts succeed; only the share if there are many maps.
 * @type {(table: Table, sides: Sides, side: number) => string}
 */
function sideTitle({ about }, sides, side) {
  const { success, valid } = sides.counts[side];
  const share = `${((100 * success) / Math.max(1, valid)).toFixed(1)} %`;
  const name = clipName(sides.names[side]);
  if (sides.names.length > 2) return `${name}: ${share}`;
  const folder = sides.folders[side] ? `, ${clipName(sides.folders[side])}` : "";
  const rate = about.adaptive ? "" : `: ${formatCount(success)} of ${formatCount(valid)} succeed (${share})`;
  return `${name}${folder}${rate}`;
}

/**
 * Write what the colours mean below the maps, for two sides with the number of rollouts of each.
 * @type {(sides: Sides) => HTMLCanvasElement[]} canvas for the colour of each kind
 */
function makeKey({ styles, names, kinds }) {
  const swatches = styles.map(() => element("canvas", { class: "swatch", "aria-hidden": "true" }));
  const entries = styles.map(({ label, meaning }, k) => {
    const count = (/** @type {number} */ side) => formatCount(kinds[side].filter((kind) => kind === k).length);
    const numbers = names.length === 2 ? `: ${names.map((name, side) => `${name} ${count(side)}`).join(", ")}` : "";
    return element("span", { title: meaning }, swatches[k], ` ${clipName(label)}${numbers}`);
  });
  byId("sides-key").replaceChildren(...entries);
  return swatches;
}

/**
 * Edges of the boxes of some rows that no other such box shares: the outline of their union on a grid.
 * @param {PlacedRows} here
 * @param {(row: number) => boolean} chosen
 * @returns {number[]} from x, from y, to x, to y of each in turn, as shares of the axes
 */
function boundaryEdges(here, chosen) {
  /** @type {Map<string, number[]>} */
  const edges = new Map();
  const toggle = (/** @type {number[]} */ ...edge) => {
    const key = edge.map((one) => one.toFixed(6)).join();
    if (!edges.delete(key)) edges.set(key, edge);
  };
  here.rows.forEach((row, k) => {
    if (!chosen(row)) return;
    const [left, low, right, high] = here.boxes.subarray(4 * k, 4 * k + 4);
    toggle(left, low, right, low);
    toggle(left, high, right, high);
    toggle(left, low, left, high);
    toggle(right, low, right, high);
  });
  return [...edges.values()].flat();
}
