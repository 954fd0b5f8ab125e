// Parallel coordinates: a line for each rollout from axis to axis, brushed along each; drawn in slices of time.
import { axisMapping, snapToGrid, axisTicks } from "./axes.js";
import { makeAxisMenu } from "./axis_menu.js";
import { clipName, gridValues } from "./data.js";
import { CLICK_REACH, byId, cssColour, drawLine, element, placeTip, pointerPosition, prepareCanvas } from "./dom.js";
import {
  clamp,
  formatApart,
  formatCount,
  formatShort,
  isRoundingRange,
  lastIndexBelow,
  rowLottery,
} from "./numbers.js";
import { setRange } from "./selection.js";

/** @import { Column } from "./data.js" */
/** @import { App, View } from "./main.js" */
/** @import { LineAxis } from "./selection.js" */

const MAX_AXES = 10; // axes side by side
const MIN_AXIS_WIDTH = 84; // CSS pixels between axes that a title needs
const DRAW_TIME = 16; // ms of drawing before the page handles events
const LINES_BETWEEN_CHECKS = 150; // lines drawn between two checks of the time
const HOVER_REACH = 7; // CSS pixels from a line to the pointer that points at it
const MOVE_REACH = 12; // CSS pixels from which a click on a title is a drag
const NAME_SPREAD = 0.2; // share of the step between names over which lines are spread
const BRUSH_WIDTH = 16; // CSS pixels of a range on its axis
const FRAME = { left: 46, right: 46, top: 52, bottom: 30 };

/** @type {(app: App) => View} */
export function parallelView(app) {
  const { table, state } = app;
  const base = /** @type {HTMLCanvasElement} */ (byId("lines-base"));
  const over = /** @type {HTMLCanvasElement} */ (byId("lines-over"));
  const tip = element("div", { class: "tip", hidden: "" });
  over.after(tip);
  const first = parallelAxes(app).map((column) => ({ column, inverted: false }));
  const order = shuffledRows(table.rows);
  const partOf = (/** @type {LineAxis} */ { column, inverted }) => {
    const { to } = axisMapping(column, inverted);
    const { values, names, low, high } = column;
    if (!names || !(high > low)) return Float32Array.from(values, to);
    const scale = 1 - NAME_SPREAD / (high - low);
    return Float32Array.from(values, (value, row) =>
      to(low + scale * (value - low) + (NAME_SPREAD * rowLottery(row)) / 1000),
    );
  };
  let every = state.lines.length ? state.lines : first;
  /** @type {Float32Array[]} shares of each axis by row */
  let parts = every.map(partOf);
  let [axes, shares] = [every, parts]; // those that fit
  let job = 0; // number of the drawing in progress
  /** @type {{ axis: number, from: number, x: number, title: boolean, dragged: boolean } | null} */
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
    menu.show(every, axes.length);
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
      axes.forEach(({ column, inverted }, axis) => {
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
        const { to } = axisMapping(column, inverted);
        const same = !column.names && isRoundingRange(column.low, column.high);
        const values = [column.high, column.low, ...(same ? [] : axisTicks(column, 4))];
        const texts = column.names ? values.map((value) => column.names?.[value] ?? "") : formatApart(values);
        if (!same) pen.fillText(texts[inverted ? 1 : 0], at, top - 4, room);
        pen.textBaseline = "top";
        if (!same) pen.fillText(texts[inverted ? 0 : 1], at, top + height + 6, room);
        pen.textBaseline = "middle";
        pen.textAlign = axis === axes.length - 1 && axes.length > 1 ? "right" : "left";
        const aside = pen.textAlign === "left" ? 5 : -5;
        pen.strokeStyle = cssColour(paper, 0.85); // dims lines behind the numbers
        pen.lineWidth = 3;
        values.slice(same ? 1 : 2).forEach((value, k) => {
          const [share, text] = [to(value), texts[same ? 0 : k + 2]];
          if (share <= 0.08 || share >= 0.92) return;
          const y = top + (1 - share) * height;
          pen.strokeText(text, places[axis] + aside, y, room / 2);
          pen.fillText(text, places[axis] + aside, y, room / 2);
        });
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
    axes.forEach(({ column, inverted }, axis) => {
      const range = state.ranges.get(column.key);
      if (!range) return;
      const { to } = axisMapping(column, inverted);
      const [low, high] = [range.low, range.high].map((value) => clamp(to(value), 0, 1)).sort((a, b) => a - b);
      pen.fillStyle = app.theme().accent;
      pen.globalAlpha = 0.22;
      pen.fillRect(xOf(axis) - BRUSH_WIDTH / 2, top + (1 - high) * height, BRUSH_WIDTH, (high - low) * height);
      pen.globalAlpha = 1;
      pen.strokeStyle = app.theme().accent;
      const size = Math.max(1, (high - low) * height);
      pen.strokeRect(xOf(axis) - BRUSH_WIDTH / 2, top + (1 - high) * height, BRUSH_WIDTH, size);
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

  /** @param {LineAxis[]} lines the new axes; none for those of the page */
  const arrange = (lines) => {
    state.lines = lines;
    every = lines.length ? lines : first;
    parts = every.map(partOf);
    fit();
    app.redraw();
  };
  const menu = makeAxisMenu(app, arrange);
  menu.show(every, every.length);
  byId("lines-reset").closest("p")?.after(menu.root);
  byId("lines-reset").addEventListener("click", () => arrange([]));

  /**
   * Move an axis to the place of another one.
   * @type {(axis: LineAxis, target: LineAxis) => void}
   */
  const move = (axis, target) => {
    if (axis === target) return;
    const later = every.indexOf(target) > every.indexOf(axis);
    const others = every.filter((one) => one !== axis);
    arrange(others.toSpliced(others.indexOf(target) + Number(later), 0, axis));
  };

  /**
   * What a click on the title of an axis does, or a drag of it to a place: it inverts, moves or drops the axis.
   * @type {(axis: number, dragged: number, x: number, y: number) => void}
   */
  const arrangeByTitle = (axis, dragged, x, y) => {
    const own = axes[axis];
    if (y > base.clientHeight) {
      if (every.length > 2) arrange(every.filter((one) => one !== own));
    } else if (dragged > MOVE_REACH) move(own, axes[nearest(x)]);
    else arrange(every.map((one) => (one === own ? { ...one, inverted: !one.inverted } : one)));
  };

  /**
   * The row whose line is next to a place, -1 for none.
   * @type {(x: number, y: number) => number}
   */
  const rowAt = (x, y) => {
    const places = axes.map((_, axis) => xOf(axis));
    const left = clamp(lastIndexBelow(places, x), 0, axes.length - 2);
    const part = clamp((x - places[left]) / (places[left + 1] - places[left]), 0, 1);
    const [share, reach] = [1 - (y - area().top) / area().height, HOVER_REACH / area().height];
    let [best, least] = [-1, reach];
    for (let row = 0; row < table.rows; row++) {
      if (!state.mask[row]) continue;
      const away = Math.abs((1 - part) * shares[left][row] + part * shares[left + 1][row] - share);
      if (away < least) [best, least] = [row, away];
    }
    return best;
  };

  /** @type {(row: number, x: number, y: number) => void} */
  const show = (row, x, y) => {
    app.point(row);
    tip.hidden = row < 0;
    if (row < 0) return;
    tip.replaceChildren(
      ...app.words(
        row,
        axes.map(({ column }) => column),
      ),
    );
    placeTip(tip, x, y);
  };

  over.addEventListener("pointerdown", (event) => {
    const [x, y] = pointerPosition(event, over);
    pressed = { axis: nearest(x), from: y, x, title: y < FRAME.top - 14, dragged: false };
    over.setPointerCapture(event.pointerId);
  });
  over.addEventListener("pointermove", (event) => {
    const [x, y] = pointerPosition(event, over);
    if (!pressed) return show(rowAt(x, y), x, y);
    if (pressed.title || (!pressed.dragged && Math.abs(y - pressed.from) < CLICK_REACH)) return;
    pressed.dragged = true;
    show(-1, x, y);
    const { column, inverted } = axes[pressed.axis];
    const along = axisMapping(column, inverted);
    setRange(state, column.key, snapToGrid(along, gridValues(column), shareAt(pressed.from), shareAt(y)));
    app.filtered();
  });
  over.addEventListener("pointerup", (event) => {
    const [x, y] = pointerPosition(event, over);
    if (pressed?.title) arrangeByTitle(pressed.axis, Math.abs(x - pressed.x), x, y);
    else if (pressed && !pressed.dragged) {
      const { key } = axes[pressed.axis].column;
      const row = rowAt(x, y);
      if (state.ranges.has(key) && Math.abs(x - xOf(pressed.axis)) <= BRUSH_WIDTH / 2) {
        setRange(state, key, null);
        app.filtered();
      } else if (row >= 0) {
        if (event.pointerType === "touch") show(row, x, y);
        app.choose(row);
      }
    }
    pressed = null;
  });
  over.addEventListener("pointercancel", () => (pressed = null));
  over.addEventListener("pointerleave", (event) => {
    if (!pressed && event.pointerType !== "touch") show(-1, 0, 0);
  });
  over.addEventListener("keydown", (event) => {
    const { column } = axes[keyed];
    const size = column.high - column.low;
    const range = state.ranges.get(column.key) ?? { low: column.low, high: column.high };
    const step = 0.05 * size * (event.key === "ArrowUp" ? 1 : -1);
    if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      const next = clamp(keyed + (event.key === "ArrowRight" ? 1 : -1), 0, axes.length - 1);
      if (event.shiftKey) move(axes[keyed], axes[next]);
      keyed = next;
    } else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      const end = event.shiftKey ? "high" : "low";
      setRange(state, column.key, { ...range, [end]: clamp(range[end] + step, column.low, column.high) });
      app.filtered();
    } else if (event.key === "Escape") {
      setRange(state, column.key, null);
      app.filtered();
    } else return;
    event.preventDefault();
    const now = state.ranges.get(axes[keyed].column.key);
    const said = now ? `from ${formatShort(now.low)} to ${formatShort(now.high)}` : "all";
    app.tell(`${axes[keyed].column.title}: ${said}; ${formatCount(state.passing)} rollouts`);
  });
  return { root: base, draw, point: drawOver, rescaled: () => (parts = every.map(partOf)) };
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
function titleLines({ label, unit, scale, names }) {
  const cut = label.indexOf(" (");
  const parts = [
    cut > 0 ? label.slice(cut + 1) : "",
    unit ? `[${unit}]` : "",
    names || scale === "linear" ? "" : scale,
  ];
  const second = parts.filter(Boolean).join(" ");
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
