// Parallel coordinates: a line for each rollout from axis to axis, brushed along each; drawn in slices of time.
import { axisMapping, snapToGrid, axisTicks } from "./axes.js";
import { clipName, gridValues } from "./data.js";
import { byId, cssColour, pointerPosition, prepareCanvas, drawLine } from "./dom.js";
import { clamp, formatCount, rowLottery, formatShort } from "./numbers.js";
import { setRange } from "./selection.js";

/** @import { Way } from "./axes.js" */
/** @import { Column } from "./data.js" */
/** @import { App, View } from "./main.js" */

const MAX_AXES = 10; // axes side by side
const MIN_AXIS_WIDTH = 84; // CSS pixels between axes that a title needs
const DRAW_TIME = 16; // ms of drawing before the page handles events
const LINES_BETWEEN_CHECKS = 150; // lines drawn between two checks of the time
const NAME_SPREAD = 0.2; // share of the step between names over which lines are spread
const FRAME = { left: 46, right: 46, top: 52, bottom: 30 };

/** @type {(app: App) => View} */
export function parallelView(app) {
  const { table, state } = app;
  const base = /** @type {HTMLCanvasElement} */ (byId("lines-base"));
  const over = /** @type {HTMLCanvasElement} */ (byId("lines-over"));
  const first = parallelAxes(app);
  /** @type {Column[]} in the order of the reader */
  let every = [...first];
  const order = shuffledRows(table.rows);
  /** @type {Map<Column, Way>} axes that are not even and upright */
  const ways = new Map();
  const partOf = (/** @type {Column} */ column) => {
    const { to } = axisMapping(column, ways.get(column));
    const { values, names, low, high } = column;
    if (!names || !(high > low)) return Float32Array.from(values, to);
    const scale = 1 - NAME_SPREAD / (high - low);
    return Float32Array.from(values, (value, row) =>
      to(low + scale * (value - low) + (NAME_SPREAD * rowLottery(row)) / 1000),
    );
  };
  /** @type {Float32Array[]} shares of each axis by row */
  let parts = every.map(partOf);
  let [axes, shares] = [every, parts];
  let job = 0; // number of the drawing in progress
  /** @type {{ axis: number, from: number, x: number, title: boolean } | null} */
  let pressed = null;
  let keyed = 0; // axis that the keyboard moves

  const area = () => ({
    left: FRAME.left,
    top: FRAME.top,
    width: base.clientWidth - FRAME.left - FRAME.right,
    height: base.clientHeight - FRAME.top - FRAME.bottom,
  });
  const xOf = (/** @type {number} */ axis) =>
    area().left + (axes.length > 1 ? axis / (axes.length - 1) : 0.5) * area().width;

  /** On a narrow screen the axes that matter most, and the margin. */
  const fit = () => {
    const room = clamp(Math.floor(base.clientWidth / MIN_AXIS_WIDTH), 2, every.length);
    const kept = every.map((_, axis) => axis).filter((axis) => axis < room - 1 || axis === every.length - 1);
    [axes, shares] = [kept.map((axis) => every[axis]), kept.map((axis) => parts[axis])];
    keyed = Math.min(keyed, axes.length - 1);
  };

  /** @returns {Promise<void>} until all lines are drawn */
  const draw = () => {
    const mine = ++job;
    fit();
    const { pen, width } = prepareCanvas(base);
    const { top, height } = area();
    const { ink, soft, line, paper } = app.theme();
    const looks = app.looks();
    const places = axes.map((_, axis) => xOf(axis));
    const opacity = clamp(9 / Math.sqrt(state.passing + 1), 0.06, 0.75);
    const stroke = (/** @type {number} */ row, /** @type {CanvasRenderingContext2D} */ on) => {
      for (let axis = 0, down = false; axis < places.length; axis++) {
        const share = shares[axis][row];
        if (Number.isNaN(share)) {
          down = false;
          continue;
        }
        const y = top + (1 - share) * height;
        if (down) on.lineTo(places[axis], y);
        else on.moveTo(places[axis], y);
        down = true;
      }
    };
    const frame = () => {
      pen.globalAlpha = 1;
      axes.forEach((column, axis) => {
        pen.strokeStyle = line;
        pen.lineWidth = 1;
        drawLine(pen, places[axis], top, places[axis], top + height);
        pen.textAlign =
          axis === 0 && axes.length > 1 ? "left" : axis === axes.length - 1 && axes.length > 1 ? "right" : "center";
        const at =
          places[axis] + (pen.textAlign === "left" ? -FRAME.left + 4 : pen.textAlign === "right" ? FRAME.right - 4 : 0);
        pen.fillStyle = ink;
        pen.textBaseline = "bottom";
        const room = axes.length > 1 ? (area().width / (axes.length - 1)) * 0.96 : width;
        titleLines(column).forEach((text, k) => pen.fillText(text, at, 18 + 15 * k, room));
        pen.fillStyle = soft;
        const { to } = axisMapping(column, ways.get(column));
        const worded = (/** @type {number} */ value) =>
          column.names ? (column.names[value] ?? "") : formatShort(value);
        const [over, under] = ways.get(column) === "inverted" ? [column.low, column.high] : [column.high, column.low];
        pen.fillText(worded(over), at, top - 4, room);
        pen.textBaseline = "top";
        pen.fillText(worded(under), at, top + height + 6, room);
        pen.textBaseline = "middle";
        pen.textAlign = axis === axes.length - 1 && axes.length > 1 ? "right" : "left";
        const aside = pen.textAlign === "left" ? 5 : -5;
        pen.strokeStyle = cssColour(paper, 0.85); // dims lines behind the numbers
        pen.lineWidth = 3;
        for (const value of axisTicks(column, ways.get(column), 4)) {
          const share = to(value);
          if (share <= 0.08 || share >= 0.92) continue;
          const y = top + (1 - share) * height;
          pen.strokeText(worded(value), places[axis] + aside, y, room / 2);
          pen.fillText(worded(value), places[axis] + aside, y, room / 2);
        }
      });
    };
    pen.fillStyle = cssColour(paper);
    drawOver();
    // a sample of the filtered rows in grey first, then the rows that pass, kinds mixed
    let next = 0;
    let stage = state.passing < table.rows ? 0 : 1;
    return new Promise((done) => {
      const go = () => {
        if (mine !== job) return done();
        const until = performance.now() + DRAW_TIME;
        pen.lineWidth = 1;
        while (performance.now() < until) {
          if (stage > 1) return done(frame());
          const end = Math.min(order.length, next + LINES_BETWEEN_CHECKS);
          if (stage === 0) {
            pen.globalAlpha = 0.12;
            pen.strokeStyle = soft;
            pen.beginPath();
            for (let k = next; k < end; k++) if (!state.mask[order[k]]) stroke(order[k], pen);
            pen.stroke();
          } else {
            pen.globalAlpha = opacity;
            for (let kind = 0; kind < looks.length; kind++) {
              pen.strokeStyle = cssColour(looks[kind].mark);
              pen.beginPath();
              for (let k = next; k < end; k++)
                if (table.kind[order[k]] === kind && state.mask[order[k]]) stroke(order[k], pen);
              pen.stroke();
            }
          }
          next = end;
          if (next >= order.length || (stage === 0 && next > 1200)) [stage, next] = [stage + 1, 0];
        }
        frame();
        requestAnimationFrame(go);
      };
      go();
    });
  };

  const drawOver = () => {
    const { pen } = prepareCanvas(over);
    const { top, height } = area();
    axes.forEach((column, axis) => {
      const range = state.ranges.get(column.key);
      if (!range) return;
      const { to } = axisMapping(column, ways.get(column));
      const [low, high] = [range.low, range.high].map((value) => clamp(to(value), 0, 1)).sort((a, b) => a - b);
      pen.fillStyle = app.theme().accent;
      pen.globalAlpha = 0.22;
      pen.fillRect(xOf(axis) - 8, top + (1 - high) * height, 16, (high - low) * height);
      pen.globalAlpha = 1;
      pen.strokeStyle = app.theme().accent;
      pen.strokeRect(xOf(axis) - 8, top + (1 - high) * height, 16, Math.max(1, (high - low) * height));
    });
    for (const row of [state.chosen, state.cursor]) {
      if (row < 0) continue;
      pen.lineWidth = 2.5;
      pen.strokeStyle = app.theme().accent;
      pen.beginPath();
      shares.forEach((share, axis) => pen.lineTo(xOf(axis), top + (1 - share[row]) * height));
      pen.stroke();
    }
  };

  const shareAt = (/** @type {number} */ y) => clamp(1 - (y - area().top) / area().height, 0, 1);
  const nearest = (/** @type {number} */ x) =>
    axes.reduce((best, _, axis) => (Math.abs(xOf(axis) - x) < Math.abs(xOf(best) - x) ? axis : best), 0);

  /**
   * Move an axis, change its mode, or drop it.
   * @param {Column} column
   * @param {number} to new position among the shown axes, -1 to stay
   * @param {boolean} dropped
   */
  const arrange = (column, to, dropped) => {
    if (dropped && every.length > 2) every = every.filter((one) => one !== column);
    else if (to >= 0) {
      const target = axes[to];
      const later = every.indexOf(target) > every.indexOf(column);
      every = every.filter((one) => one !== column);
      every.splice(every.indexOf(target) + Number(later && target !== column), 0, column);
    } else {
      const next = nextAxisMode(column, ways.get(column));
      if (next) ways.set(column, next);
      else ways.delete(column);
    }
    parts = every.map(partOf);
    fit();
    app.redraw();
  };
  byId("lines-reset").addEventListener("click", () => {
    every = [...first];
    ways.clear();
    parts = every.map(partOf);
    fit();
    app.redraw();
  });

  over.addEventListener("pointerdown", (event) => {
    const [x, y] = pointerPosition(event, over);
    pressed = { axis: nearest(x), from: y, x, title: y < FRAME.top - 14 };
    over.setPointerCapture(event.pointerId);
  });
  over.addEventListener("pointermove", (event) => {
    if (!pressed || pressed.title) return;
    const [, y] = pointerPosition(event, over);
    if (Math.abs(y - pressed.from) < 4) return;
    const column = axes[pressed.axis];
    const along = axisMapping(column, ways.get(column));
    setRange(state, column.key, snapToGrid(along, gridValues(column), shareAt(pressed.from), shareAt(y)));
    app.filtered();
  });
  over.addEventListener("pointerup", (event) => {
    const [x, y] = pointerPosition(event, over);
    if (pressed?.title)
      arrange(axes[pressed.axis], Math.abs(x - pressed.x) > 12 ? nearest(x) : -1, y > base.clientHeight);
    else if (pressed && Math.abs(y - pressed.from) < 4) {
      setRange(state, axes[pressed.axis].key, null);
      app.filtered();
    }
    pressed = null;
  });
  over.addEventListener("keydown", (event) => {
    const column = axes[keyed];
    const size = column.high - column.low;
    const range = state.ranges.get(column.key) ?? { low: column.low, high: column.high };
    const step = 0.05 * size * (event.key === "ArrowUp" ? 1 : -1);
    if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      keyed = clamp(keyed + (event.key === "ArrowRight" ? 1 : -1), 0, axes.length - 1);
    } else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      const end = event.shiftKey ? "high" : "low";
      setRange(state, column.key, { ...range, [end]: clamp(range[end] + step, column.low, column.high) });
      app.filtered();
    } else if (event.key === "Escape") {
      setRange(state, column.key, null);
      app.filtered();
    } else return;
    event.preventDefault();
    const now = state.ranges.get(axes[keyed].key);
    const said = now ? `from ${formatShort(now.low)} to ${formatShort(now.high)}` : "all";
    app.tell(`${axes[keyed].title}: ${said}; ${formatCount(state.passing)} rollouts`);
  });
  return { root: base, draw, point: drawOver };
}

/**
 * Next mode of an axis when its title is clicked: linear, inverted, logarithmic if possible, linear again.
 * @type {(column: Column, way?: Way) => Way | undefined}
 */
function nextAxisMode({ low, names }, way) {
  if (!way) return "inverted";
  return way === "inverted" && low > 0 && !names ? "log" : undefined;
}

/**
 * Columns of the axes: varied parameters, the most important first, or else all columns.
 * @type {(app: App) => Column[]}
 */
function parallelAxes({ table, ranked }) {
  const axes = ranked.map(({ column }) => column);
  const rest = table.columns.filter((column) => column.axis && !axes.includes(column));
  const margin = table.columns.filter(({ key }) => key === "margin");
  return [...axes, ...rest].slice(0, MAX_AXES - margin.length).concat(margin);
}

/** @type {(column: Column) => string[]} */
function titleLines({ label, unit }) {
  const cut = label.indexOf(" (");
  const second = [cut > 0 ? label.slice(cut + 1) : "", unit ? `[${unit}]` : ""].filter(Boolean).join(" ");
  return [clipName(cut > 0 ? label.slice(0, cut) : label), second];
}

/**
 * Rows in a reproducible random order, so that any part is a fair sample.
 * @type {(count: number) => Uint32Array}
 */
export function shuffledRows(count) {
  const order = Uint32Array.from({ length: count }, (_, k) => k);
  let seed = 1;
  for (let k = count - 1; k > 0; k--) {
    seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
    const other = Math.floor((seed / 2 ** 32) * (k + 1));
    [order[k], order[other]] = [order[other], order[k]];
  }
  return order;
}
