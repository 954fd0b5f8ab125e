// The map: every rollout over two columns, as cells or marks; hover, brush, keyboard.
import { axisTitle, chartBox, drawFrame, wholeCells } from "./axes.js";
import { makeScaleChoice } from "./scale_choice.js";
import { placeRows } from "./cells.js";
import { clipName, inflate, readCounts, sortedValues } from "./data.js";
import {
  CLICK_REACH,
  byId,
  element,
  fillSelect,
  columnOptions,
  placeTip,
  pointerPosition,
  prepareCanvas,
} from "./dom.js";
import {
  GLYPHED,
  KIND,
  markSize,
  paintCells,
  drawVectorCells,
  drawVectorMarks,
  paintDensity,
  paintMarks,
  RATE,
  colourRange,
  rowAtPoint,
  rowPosition,
} from "./map_fill.js";
import { MAX_VECTORS, isVectorPen } from "./marks.js";
import { clamp, formatCount, packRgb, scaleColour, formatShort } from "./numbers.js";
import { GLYPH_SIZE, makePixels } from "./raster.js";
import {
  drawAnalyticLimits,
  drawCertifiedRegion,
  drawContour,
  drawOutlines,
  drawPointedRows,
  drawRing,
  drawZeroMargin,
  regionLines,
} from "./map_overlays.js";
import { setRange, clearFilters, isInSlice } from "./selection.js";

/** @import { Box } from "./axes.js" */
/** @import { PlacedRows } from "./cells.js" */
/** @import { Column } from "./data.js" */
/** @import { Rgb } from "./dom.js" */
/** @import { App, View } from "./main.js" */
/** @import { Pixels } from "./raster.js" */

const MARGIN = { left: 64, right: 14, top: 12, bottom: 48 };

/** @type {(app: App) => View} */
export function mapView(app) {
  const { table, state } = app;
  const base = /** @type {HTMLCanvasElement} */ (byId("map-base"));
  const over = /** @type {HTMLCanvasElement} */ (byId("map-over"));
  const tip = byId("map-tip");
  const selects = ["map-x", "map-y", "map-colour"].map((id) => /** @type {HTMLSelectElement} */ (byId(id)));
  const names = columnOptions(table.columns);
  const { wanted } = app;
  const start = [wanted.x, wanted.y].every((key) => table.named.has(key)) ? [wanted.x, wanted.y] : startColumns(app);
  fillSelect(selects[0], names, start[0]);
  fillSelect(selects[1], names, start[1]);
  const numbers = columnOptions(table.columns.filter((column) => !column.names));
  /** @type {[string, string][]} */
  const rates = table.about.adaptive ? [] : [[RATE, "rate of success"]];
  fillSelect(selects[2], [[KIND, "outcome and cause"], ...rates, ...numbers], KIND);
  if ((wanted.colour === RATE && rates.length) || table.named.has(wanted.colour)) selects[2].value = wanted.colour;

  const scales = ["across", "up"].map((way, k) => {
    const choice = makeScaleChoice(app, `scale ${way}`);
    selects[k].after(choice.select);
    return choice;
  });

  /** @type {PlacedRows | null} */
  let places = null;
  /** @type {Pixels | null} */
  let pixels = null;
  /** @type {{ x: number, y: number, part: "both" | "x" | "y" } | null} */
  let pressed = null;
  /** @type {[number, number] | null} the row's place that the keyboard is at */
  let anchor = null;
  /** @type {Map<string, Uint32Array>} */
  const counted = new Map();

  const columns = () => selects.slice(0, 2).map((select) => table.named.get(select.value) ?? table.columns[0]);
  const box = () => chartBox(base, MARGIN);

  const lay = () => {
    const [x, y] = columns();
    places = placeRows(table, x, y, (row) => isInSlice(state, row), box().width / 70);
    anchor = null;
  };

  const slicing = () => {
    const [x, y] = columns();
    const kept = new Map(state.fixed);
    state.fixed.clear();
    const shown = table.columns.filter((column) => {
      if (!column.axis || column === x || column === y || (column.drawn && !column.names)) return false;
      const count = sortedValues(column).length;
      return count > 1 && count <= 200;
    });
    byId("map-slices").replaceChildren(
      ...shown.slice(0, 8).map((column) => {
        const select = element("select", {});
        const values = sortedValues(column);
        const options = values.map(
          (value) => /** @type {[string, string]} */ ([String(value), formatColumnValue(column, value)]),
        );
        const chosen = values.find((value) => value === kept.get(column.key));
        fillSelect(select, [["", "all"], ...options], chosen === undefined ? "" : String(chosen));
        if (chosen !== undefined) state.fixed.set(column.key, chosen);
        select.addEventListener("change", () => {
          if (select.value) state.fixed.set(column.key, Number(select.value));
          else state.fixed.delete(column.key);
          lay();
          app.redraw();
        });
        return element("label", {}, clipName(column.title), select);
      }),
    );
  };

  const densityOf = () => {
    const [x, y] = columns();
    return selects[2].value === KIND
      ? table.about.densities.find((one) => one.x === x.key && one.y === y.key)
      : undefined;
  };

  const draw = () => {
    if (!places) lay();
    const sheet = prepareCanvas(base);
    const area = box();
    const { ratio } = sheet;
    const [width, height] = [Math.round(area.width * ratio), Math.round(area.height * ratio)];
    if (!pixels || pixels.width !== width || pixels.height !== height) pixels = makePixels(width, height);
    pixels.colours.fill(packRgb(...app.theme().paper));
    pixels.owner.fill(-1);
    const here = /** @type {PlacedRows} */ (places);
    const density = densityOf();
    const counts = density && counted.get(`${density.x} ${density.y}`);
    if (density && !counts) {
      void inflate(density.block).then((buffer) => {
        counted.set(`${density.x} ${density.y}`, readCounts(buffer));
        app.redraw();
      });
    }
    const filtered = state.passing < table.rows;
    if (density && counts) paintDensity(app, pixels, here, density, counts, filtered);
    const by = selects[2].value;
    const isImage = density || !isVectorPen(sheet.pen) || here.rows.length > MAX_VECTORS;
    if (isImage && (!density || filtered)) {
      if (here.form === "cells") paintCells(app, pixels, here, by, ratio);
      else paintMarks(app, pixels, here, by, ratio);
    }
    if (isImage) sheet.pen.putImageData(pixels.image, Math.round(area.left * ratio), Math.round(area.top * ratio));
    else if (here.form === "cells") drawVectorCells(app, sheet.pen, here, by, area);
    else drawVectorMarks(app, sheet.pen, here, by, area);
    drawOutlines(app, sheet.pen, here, area);
    const [x, y] = columns();
    drawAnalyticLimits(app, sheet.pen, x, y, here, area);
    drawZeroMargin(app, sheet.pen, x, y, here, area);
    drawCertifiedRegion(app, sheet.pen, x, y, here, area);
    const coloured = table.named.get(selects[2].value);
    if (coloured?.diverges && !x.names && !y.names) drawContour(app, sheet.pen, here, coloured, area);
    drawReplayed(sheet.pen, here, area);
    const [across, up] = [
      { scale: here.x, title: axisTitle(x, here.x) },
      { scale: here.y, title: axisTitle(y, here.y) },
    ];
    drawFrame(sheet, app.theme(), area, across, up);
    scales.forEach((choice, k) => choice.show(columns()[k]));
    drawKey();
    drawOver();
    app.drawnAs(density && !filtered ? "cells" : here.form);
  };

  /** The scale of colours that are numbers, or what marks mean. */
  const drawKey = () => {
    const note = byId("map-key");
    const colour = selects[2].value;
    const column = table.named.get(colour);
    note.replaceChildren();
    if (colour !== KIND) {
      const bar = element("canvas", { width: "120", height: column?.diverges ? "24" : "10", "aria-hidden": "true" });
      const pen = /** @type {CanvasRenderingContext2D} */ (bar.getContext("2d"));
      const strip = new ImageData(120, 10);
      const memory = new Uint32Array(strip.data.buffer);
      for (let k = 0; k < memory.length; k++) memory[k] = scaleColour((k % 120) / 119, column?.diverges);
      pen.putImageData(strip, 0, 0);
      if (column?.diverges) {
        pen.fillStyle = app.theme().ink;
        pen.fillRect(59, 0, 2, 13);
        pen.textAlign = "center";
        pen.font = "11px sans-serif";
        pen.fillText("0", 60, 23);
      }
      const span = column ? colourRange(column) : [0, 1];
      const most = Math.max(-span[0], span[1]);
      const [low, high] = column?.diverges ? [-most, most] : span;
      const rate = places?.bins ? `rate of success in ${places.bins} by ${places.bins} bins` : "rate of success";
      note.append(column ? column.title : rate, " ", formatShort(low), " ", bar, " ", formatShort(high));
      note.append(column?.diverges && places?.form === "cells" ? "; the line on the map is at 0." : ".");
    } else if (densityOf()) {
      const [all, few] = [table.about.total, table.rows].map(formatCount);
      note.append(`${all} rollouts counted in cells; a choice is shown by ${few} of them, drawn at random.`);
    } else if (table.about.total > table.rows) {
      note.append(`${formatCount(table.rows)} of ${formatCount(table.about.total)} rollouts, drawn at random.`);
    } else if (table.mesh && places?.outlines.length) {
      note.append("Cells as refinement left them: each quarter shows the rollout at its corner.");
    } else if (places?.form === "cells" && new Set(places.cell).size < places.rows.length) {
      note.append("Rollouts of equal values stand beside each other in their cell.");
    }
    if (table.replayed.size) note.append(" Rings: rollouts with a replay of their own.");
    const { region } = table.about;
    if (region && regionLines(region, columns()[0].key, columns()[1].key).length) {
      const cut = region.section ? ", cut through the middle of its other parameters" : "";
      note.append(` Line around points: the certified region${cut}.`);
    }
  };

  /**
   * Draw rings around rollouts that have a replay.
   * @type {(pen: CanvasRenderingContext2D, here: PlacedRows, area: Box) => void}
   */
  const drawReplayed = (pen, here, area) => {
    const done = new Set();
    here.rows.forEach((row, k) => {
      if (!table.replayed.has(row) || done.has(row) || !state.mask[row]) return;
      done.add(row);
      const size = here.form === "marks" ? markSize(here) + 2.6 : ringSize(here, k, area);
      drawRing(app, pen, rowPosition(here, k, area), size, app.theme().ink, [3.4, 1.3]);
    });
  };

  /** The brush, the chosen row and the one under the pointer. */
  const drawOver = () => {
    const { pen } = prepareCanvas(over);
    const area = box();
    const here = places;
    if (!here) return;
    const [x, y] = columns();
    const [a, b] = [state.ranges.get(x.key), state.ranges.get(y.key)];
    if (a || b) {
      const left = a ? clamp(here.x.to(a.low), 0, 1) : 0;
      const right = a ? clamp(here.x.to(a.high), 0, 1) : 1;
      const low = b ? clamp(here.y.to(b.low), 0, 1) : 0;
      const high = b ? clamp(here.y.to(b.high), 0, 1) : 1;
      pen.strokeStyle = app.theme().accent;
      pen.lineWidth = 1.5;
      pen.strokeRect(
        area.left + left * area.width,
        area.top + (1 - high) * area.height,
        (right - left) * area.width,
        (high - low) * area.height,
      );
    }
    drawPointedRows(app, pen, here, area);
  };

  const rowAt = (/** @type {number} */ x, /** @type {number} */ y) => rowAtPoint(pixels, places, box(), [x, y]);

  /** @param {number} row */
  const show = (row) => {
    app.point(row);
    tip.hidden = row < 0;
    if (row < 0 || !places) return;
    tip.replaceChildren(...app.words(row, columns()));
    const k = places.rows.indexOf(row);
    if (k < 0) return;
    const [u, v] = rowPosition(places, k, box());
    placeTip(tip, u, v);
  };

  over.addEventListener("pointerdown", (event) => {
    const [x, y] = pointerPosition(event, over);
    const area = box();
    const part = y > area.top + area.height ? "x" : x < area.left ? "y" : "both";
    pressed = { x, y, part };
    over.setPointerCapture(event.pointerId);
  });
  over.addEventListener("pointermove", (event) => {
    const [x, y] = pointerPosition(event, over);
    if (!pressed) {
      show(rowAt(x, y));
      drawOver();
      return;
    }
    if (Math.hypot(x - pressed.x, y - pressed.y) < CLICK_REACH) return;
    tip.hidden = true;
    brush(pressed, x, y);
  });
  over.addEventListener("pointerup", (event) => {
    const [x, y] = pointerPosition(event, over);
    if (pressed && Math.hypot(x - pressed.x, y - pressed.y) < CLICK_REACH) {
      const row = rowAt(x, y);
      if (row < 0) brushOff();
      else {
        if (event.pointerType === "touch") show(row);
        app.choose(row);
      }
    }
    pressed = null;
  });
  over.addEventListener("pointercancel", () => (pressed = null));
  over.addEventListener("pointerleave", (event) => {
    if (pressed || event.pointerType === "touch") return;
    show(-1);
    drawOver();
  });
  over.addEventListener("keydown", (event) => {
    const ways = /** @type {Record<string, [number, number]>} */ ({
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, 1],
      ArrowDown: [0, -1],
    });
    const way = ways[event.key];
    if (way && places) {
      const row = stepFrom(places, state.cursor, way, (one) => event.shiftKey || state.mask[one] > 0);
      if (event.shiftKey && state.cursor >= 0) {
        const [x, y] = columns();
        anchor ??= [x.values[state.cursor], y.values[state.cursor]];
        setRange(state, x.key, rangeAround(x, anchor[0], x.values[row]));
        setRange(state, y.key, rangeAround(y, anchor[1], y.values[row]));
        state.cursor = row;
        app.filtered();
      } else anchor = null;
      show(row);
      drawOver();
      app.tell(spokenText(tip));
    } else if ((event.key === "Enter" || event.key === " ") && state.cursor >= 0) app.choose(state.cursor);
    else if (event.key === "Escape") {
      clearFilters(state);
      anchor = null;
      app.filtered();
    } else return;
    event.preventDefault();
  });
  selects.forEach((select, k) =>
    select.addEventListener("change", () => {
      if (k < 2) {
        slicing();
        lay();
      }
      app.redraw();
    }),
  );

  /** @type {(from: { x: number, y: number, part: "both" | "x" | "y" }, toX: number, toY: number) => void} */
  const brush = (from, toX, toY) => {
    if (!places) return;
    const area = box();
    const here = places;
    const [x, y] = columns();
    const across = (/** @type {number} */ at) => clamp((at - area.left) / area.width, 0, 1);
    const up = (/** @type {number} */ at) => clamp(1 - (at - area.top) / area.height, 0, 1);
    if (from.part !== "y") setRange(state, x.key, wholeCells(here.x, across(from.x), across(toX)));
    if (from.part !== "x") setRange(state, y.key, wholeCells(here.y, up(from.y), up(toY)));
    app.filtered();
  };

  const brushOff = () => {
    const [x, y] = columns();
    setRange(state, x.key, null);
    setRange(state, y.key, null);
    anchor = null;
    app.filtered();
  };

  slicing();
  return {
    root: base,
    draw,
    point: drawOver,
    resized: () => (places = null),
    rescaled: () => (places = null),
  };
}

/**
 * Radius of a ring in a cell: around the glyph of the cause where the cell has one.
 * @type {(here: PlacedRows, k: number, area: Box) => number}
 */
function ringSize({ boxes }, k, area) {
  const width = (boxes[4 * k + 2] - boxes[4 * k]) * area.width;
  const height = (boxes[4 * k + 3] - boxes[4 * k + 1]) * area.height;
  const least = Math.min(width, height);
  return least < GLYPHED ? 3.2 : Math.min(GLYPH_SIZE + 5.5, least / 2 - 1);
}

/**
 * Text of a description for a screen reader: its parts apart, each name with its value.
 * @type {(tip: Element) => string}
 */
export function spokenText(tip) {
  const parts = [...tip.querySelectorAll("strong, dt, span")].map((part) => {
    const value = part.matches("dt") ? ` ${part.nextElementSibling?.textContent ?? ""}` : "";
    return `${part.textContent}${value}`;
  });
  return parts.join(", ");
}

/**
 * Range that includes two values.
 * @type {(column: Column, a: number, b: number) => { low: number, high: number }}
 */
function rangeAround(column, a, b) {
  const room = 1e-9 * (column.high - column.low || 1);
  return { low: Math.min(a, b) - room, high: Math.max(a, b) + room };
}

/**
 * Format a value of a column.
 * @type {(column: Column, value: number) => string}
 */
export function formatColumnValue(column, value) {
  if (Number.isNaN(value)) return "–";
  if (column.names) return column.names[value] ?? "";
  return column.unit ? `${formatShort(value)} ${column.unit}` : formatShort(value);
}

/**
 * Columns that the map starts with: those of the page, or the two parameters most strongly related to failure. If each
 * parameter was varied alone, the second column is the margin.
 * @type {(app: App) => [string, string]}
 */
function startColumns({ table, ranked }) {
  const { start } = table.about;
  const numbers = table.columns.filter((column) => !column.names);
  const first = start[0] ?? ranked[0]?.column.key ?? numbers[0]?.key ?? table.columns[0]?.key ?? "";
  const free = (/** @type {string} */ key) => table.named.has(key) && key !== first;
  const second = ranked[1]?.column.key ?? "";
  const beside = [
    start[1] ?? "",
    ...(table.about.one_at_a_time ? ["margin", second] : [second, "margin"]),
    ...numbers.map(({ key }) => key),
  ].find(free);
  const upwards = beside ?? first;
  const named = (/** @type {string} */ key) => !!table.named.get(key)?.names;
  return named(first) && !named(upwards) ? [upwards, first] : [first, upwards]; // names fit beside the map
}

/**
 * Nearest row in a direction; sideways distance counts twice.
 * @type {(here: PlacedRows, row: number, way: [number, number], passes: (row: number) => boolean) => number}
 */
export function stepFrom(here, row, way, passes) {
  const unit = { left: 0, top: 0, width: 1, height: 1 };
  const from = here.rows.indexOf(row);
  if (from < 0) return here.rows.find(passes) ?? -1;
  const [x, y] = rowPosition(here, from, unit);
  let best = row;
  let least = Infinity;
  here.rows.forEach((other, k) => {
    if (other === row || !passes(other)) return;
    const [u, v] = rowPosition(here, k, unit);
    const [right, up] = [u - x, y - v];
    const ahead = right * way[0] + up * way[1];
    const aside = Math.abs(right * way[1]) + Math.abs(up * way[0]);
    const away = ahead + 2 * aside;
    if (ahead > 1e-9 && aside <= ahead && away < least) [best, least] = [other, away];
  });
  return best;
}
