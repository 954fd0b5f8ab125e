// Plots of a replay over time, with stages, a cursor that reads all of them, and zoom.
import {
  byId,
  element,
  fillSelect,
  makeButton,
  pointerPosition,
  prepareCanvas,
  drawLine,
  shortenToFit,
} from "./dom.js";
import { frameAt, stageSpans } from "./kinematics.js";
import { clamp, formatShort, ticks } from "./numbers.js";
import { PANEL_MARGIN, drawPaths, drawRuledFrame, replayPaths, pointPaths, PATH_VIEWS } from "./path.js";
import { freeJointIndex, replaySeries } from "./series.js";

/** @import { App } from "./main.js" */
/** @import { Paths, Reel } from "./path.js" */
/** @import { Histories } from "./series.js" */

/** @typedef {{ base: HTMLCanvasElement, over: HTMLCanvasElement }} Panel */
/** @typedef {[number, number]} Span from and to, s */

const MIN_STEPS = 12; // steps of the stored values that a panel is high at least
const TOLD_STEPS = 60; // steps below which the panel names their size
const MAX_READINGS = 6; // lines of a panel that the cursor reads one by one
const SHORTEST_SPAN = 0.02; // share of a replay
const NEAR_LINE = 24; // CSS pixels, farthest line that the pointer names

/**
 * Panels below the replay.
 * @param {App} app
 * @param {(time: number) => void} to jumps to a time
 * @returns {{ show: (reels: (Reel | null)[], total: number) => void, draw: () => void, point: (time: number) => void,
 *   span: () => Span | null }}
 */
export function historyView(app, to) {
  const root = byId("histories");
  const box = /** @type {HTMLDetailsElement} */ (byId("histories-box"));
  const choice = element("select", { id: "histories-group" });
  fillSelect(
    choice,
    [
      ["", "robot and policy"],
      ["robot", "the robot"],
      ["policy", "the policy"],
    ],
    "",
  );
  const choiceLabel = element("label", {}, "plots of ", choice);
  /** @type {Panel[]} */
  let panels = [];
  /** @type {Panel[]} of paths */
  let maps = [];
  /** @type {{ reel: Reel, histories: Histories[], paths: Paths }[]} */
  let shown = [];
  let total = 1;
  let time = 0;
  /** @type {Span | null} part of the time that is shown; null for all of it */
  let span = app.wanted.span;
  /** @type {{ panel: number, time: number, y: number } | null} place of the pointer */
  let pointer = null;
  /** @type {{ panel: number, from: number } | null} a range that is being chosen */
  let chosen = null;
  /** @type {Map<HTMLCanvasElement, string>} what cursors show: where they are, and words */
  const pointed = new Map();
  /** @type {[number, number][]} range of values of each panel */
  let heights = [];

  /** @returns {Span} */
  const visible = () => span ?? [0, total];
  const plotWidth = (/** @type {number} */ width) => width - PANEL_MARGIN.left - PANEL_MARGIN.right;
  const xOf = (/** @type {number} */ at, /** @type {number} */ width) =>
    PANEL_MARGIN.left + ((at - visible()[0]) / (visible()[1] - visible()[0])) * plotWidth(width);
  const timeAt = (/** @type {PointerEvent | WheelEvent} */ event, /** @type {HTMLCanvasElement} */ canvas) => {
    const [from, until] = visible();
    const share = (pointerPosition(event, canvas)[0] - PANEL_MARGIN.left) / plotWidth(canvas.clientWidth);
    return clamp(from + share * (until - from), from, until);
  };

  /** @type {(wanted: Span | null) => void} */
  const zoomTo = (wanted) => {
    span = wanted;
    if (wanted) {
      const length = clamp(wanted[1] - wanted[0], SHORTEST_SPAN * total, total);
      const from = clamp(wanted[0], 0, total - length);
      span = length > 0.999 * total ? null : [from, from + length];
    }
    whole.disabled = !span;
    draw();
    app.remember();
  };
  const zoomBy = (/** @type {number} */ factor, about = time) => {
    const [from, until] = visible();
    zoomTo([about + (from - about) * factor, about + (until - about) * factor]);
  };

  const draw = () => {
    if (!box.open || !shown.length) return;
    panels.forEach(({ base }, k) => isListed(k) && drawPanel(base, k));
    const paths = shown.map((one) => one.paths);
    maps.forEach(({ base }, k) => drawPaths(app, base, paths, PATH_VIEWS[k]));
    pointed.clear();
    point(time);
  };

  const isListed = (/** @type {number} */ k) => !choice.value || shown[0].histories[k].group === choice.value;

  /** @type {(k: number) => Float64Array[][]} lines of a panel for each replay */
  const linesOf = (k) =>
    shown.map(({ histories }) => histories.find(({ title }) => title === shown[0].histories[k].title)?.lines ?? []);

  /**
   * Range of a panel's values in the visible time, no smaller than `MIN_STEPS` stored steps.
   * @type {(k: number) => [number, number]}
   */
  const rangeOf = (k) => {
    const { limit, resolution } = shown[0].histories[k];
    let [low, high] = [Infinity, -Infinity];
    linesOf(k).forEach((lines, number) => {
      const { motion } = shown[number].reel;
      const [first, last] = visible().map((at) => frameAt(motion, at));
      for (const values of lines)
        for (let frame = first; frame <= last; frame++)
          [low, high] = [Math.min(low, values[frame]), Math.max(high, values[frame])];
    });
    if (limit !== null && Math.max(-low, high) > 0.6 * limit)
      [low, high] = [low < 0 ? Math.min(low, -limit) : low, Math.max(high, limit)];
    const missing = Math.max(MIN_STEPS * resolution - (high - low), high > low ? 0 : 1e-9) / 2;
    return [low - missing, high + missing];
  };

  /** @type {(canvas: HTMLCanvasElement, k: number) => void} */
  const drawPanel = (canvas, k) => {
    const sheet = prepareCanvas(canvas);
    const { pen, width, height } = sheet;
    const { ink, line } = app.theme();
    const colours = app.table.about.legs;
    const [top, bottom] = [PANEL_MARGIN.top, height - PANEL_MARGIN.bottom];
    const [left, right] = [PANEL_MARGIN.left, width - PANEL_MARGIN.right];
    const [first] = shown;
    pen.fillStyle = line;
    for (const { stage, from, to } of stageSpans(first.reel.motion)) {
      pen.globalAlpha = stage % 2 ? 0.34 : 0.1;
      const [start, end] = [from, to].map((at) => clamp(xOf(at, width), left, right));
      pen.fillRect(start, top, end - start, bottom - top);
    }
    pen.globalAlpha = 1;
    const { title, limit, resolution } = first.histories[k];
    heights[k] = rangeOf(k);
    const [low, high] = heights[k];
    const yOf = (/** @type {number} */ value) => valueHeight(k, value, height);
    const across = ticks(low, high, 4).map((value) => ({ at: yOf(value), text: formatShort(value) }));
    const below = ticks(...visible(), width / 90).map((at) => ({ at: xOf(at, width), text: `${formatShort(at)} s` }));
    const coarse = high - low < TOLD_STEPS * resolution ? `, in steps of ${formatShort(resolution)}` : "";
    pen.font = pen.font.replace(/\d+px/, "11px");
    drawRuledFrame(sheet, app.theme(), across, below, shortenToFit(pen, title + coarse, right - left), right - left);
    pen.save();
    pen.beginPath();
    pen.rect(left, top - 1, right - left, bottom - top + 2);
    pen.clip();
    if (limit !== null && Math.max(-low, high) >= limit) {
      pen.strokeStyle = ink;
      pen.setLineDash([2, 3]);
      for (const at of low < 0 ? [limit, -limit] : [limit]) drawLine(pen, left, yOf(at), right, yOf(at));
    }
    linesOf(k).forEach((own, number) => {
      const { motion } = shown[number].reel;
      pen.setLineDash(number ? [4, 3] : []);
      own.forEach((values, leg) => {
        pen.strokeStyle = own.length > 1 ? colours[leg % colours.length] : ink;
        pen.lineWidth = 1.2;
        pen.beginPath();
        values.forEach((value, frame) => pen.lineTo(xOf((frame + 1) * motion.step, width), yOf(value)));
        pen.stroke();
      });
    });
    pen.restore();
    pen.setLineDash([]);
  };

  /** @type {(k: number, value: number, height: number) => number} */
  const valueHeight = (k, value, height) => {
    const [low, high] = heights[k] ?? rangeOf(k);
    const room = 0.04 * (high - low);
    const bottom = height - PANEL_MARGIN.bottom;
    return bottom - ((value - low + room) / (high - low + 2 * room)) * (bottom - PANEL_MARGIN.top);
  };

  /**
   * What the cursor reads in a panel: text and colour of each part.
   * @type {(k: number, at: number, height: number) => [string, string][]}
   */
  const readings = (k, at, height) => {
    const [{ reel, histories }] = shown;
    const { limitNames, lines, names, resolution } = histories[k];
    const { ink } = app.theme();
    const colours = app.table.about.legs;
    const frame = frameAt(reel.motion, at);
    const values = lines.map((line) => line[frame]);
    const readable = (/** @type {number} */ value) =>
      formatShort(Number((Math.round(value / resolution) * resolution).toPrecision(3)));
    const colourOf = (/** @type {number} */ line) => (lines.length > 1 ? colours[line % colours.length] : ink);
    if (limitNames) return [[`${limitNames[frame]} ${formatShort(values[0])}`, ink]];
    if (pointer?.panel === k && names.length) {
      const away = values.map((value) => Math.abs(valueHeight(k, value, height) - (pointer?.y ?? 0)));
      const near = away.indexOf(Math.min(...away));
      if (away[near] < NEAR_LINE) return [[`${names[near]} ${readable(values[near])}`, colourOf(near)]];
    }
    if (values.length > MAX_READINGS)
      return [[`${readable(Math.min(...values))} to ${readable(Math.max(...values))}`, ink]];
    return values.map((value, line) => [readable(value), colourOf(line)]);
  };
  /** @param {number} now */
  const point = (now) => {
    time = now;
    if (!box.open || !shown.length) return;
    const [from, until] = visible();
    if (span && !chosen && (now < from || now > until)) return zoomTo([now - 0.1 * (until - from), until + now - from]);
    const paths = shown.map((one) => one.paths);
    maps.forEach(({ over }, k) => {
      if (app.visible(over)) pointPaths(app, over, paths, PATH_VIEWS[k], shown[0].reel.motion, time);
    });
    panels.forEach(({ over }, k) => isListed(k) && app.visible(over) && pointPanel(over, k));
  };

  /** @type {(canvas: HTMLCanvasElement, k: number) => void} */
  const pointPanel = (canvas, k) => {
    const at = pointer?.time ?? time;
    const read = readings(k, at, canvas.clientHeight);
    const [x, hovered] = [time, at].map((one) => Math.round(xOf(one, canvas.clientWidth)));
    const start = chosen?.panel === k ? Math.round(xOf(chosen.from, canvas.clientWidth)) : hovered;
    const state = [x, hovered, start, ...read].join();
    if (pointed.get(canvas) === state) return; // most frames of a long replay move it by less than a pixel
    pointed.set(canvas, state);
    const { pen, width, height } = prepareCanvas(canvas);
    const [top, length] = [PANEL_MARGIN.top, height - PANEL_MARGIN.top - PANEL_MARGIN.bottom];
    pen.fillStyle = app.theme().accent;
    pen.globalAlpha = 0.2;
    pen.fillRect(Math.min(start, hovered), top, Math.abs(hovered - start), length);
    pen.globalAlpha = 1;
    pen.fillStyle = app.theme().ink;
    pen.fillRect(x - 0.75, top, 1.5, length);
    pen.fillStyle = app.theme().soft;
    if (pointer) pen.fillRect(hovered - 0.5, top, 1, length);
    pen.font = pen.font.replace(/\d+px/, "11px");
    pen.textAlign = "left";
    pen.textBaseline = "top";
    let place = PANEL_MARGIN.left;
    for (const [text, colour] of pointer ? [[`${at.toFixed(2)} s`, app.theme().soft], ...read] : read) {
      const fitting = shortenToFit(pen, text, width - place);
      pen.fillStyle = colour;
      pen.fillText(fitting, place, 17);
      place += pen.measureText(fitting).width + 8;
    }
  };

  /** @type {(k: number, title: string) => Panel} */
  const makePanel = (k, title) => {
    const each = shown[0].reel.model.feet.length ? "leg" : "joint";
    const label = `${title} over time, a line for each ${each}; drag to go to a time, with Shift to zoom`;
    const base = element("canvas", { role: "img", "aria-label": label });
    const over = element("canvas", { class: "over", "aria-hidden": "true" });
    over.addEventListener("pointerdown", (event) => {
      over.setPointerCapture(event.pointerId);
      if (event.shiftKey) chosen = { panel: k, from: timeAt(event, over) };
      else to(timeAt(event, over));
    });
    over.addEventListener("pointermove", (event) => {
      const at = timeAt(event, over);
      pointer = event.pointerType === "mouse" ? { panel: k, time: at, y: pointerPosition(event, over)[1] } : null;
      if (event.buttons && !chosen) to(at);
      else point(time);
    });
    over.addEventListener("pointerup", (event) => {
      const ends = chosen && [chosen.from, timeAt(event, over)].sort((a, b) => a - b);
      chosen = null;
      if (ends && ends[1] > ends[0]) zoomTo([ends[0], ends[1]]);
    });
    over.addEventListener("pointerleave", () => {
      pointer = null;
      point(time);
    });
    over.addEventListener("dblclick", () => zoomTo(null));
    over.addEventListener(
      "wheel",
      (event) => {
        if (!event.ctrlKey && !event.shiftKey) return; // which scrolls the page
        event.preventDefault();
        zoomBy(Math.exp(clamp(event.deltaY || event.deltaX, -200, 200) / 300), timeAt(event, over));
      },
      { passive: false },
    );
    return { base, over };
  };

  const lay = () => {
    pointer = chosen = null;
    heights = [];
    panels = (shown[0]?.histories ?? []).map(({ title }, k) => makePanel(k, title));
    const hasPolicy = shown[0]?.histories.some(({ group }) => group === "policy");
    choiceLabel.hidden = !hasPolicy;
    if (!hasPolicy) choice.value = "";
    const moves = shown[0]?.paths.base.length;
    maps = (moves ? PATH_VIEWS : []).map(({ title }) => ({
      base: element("canvas", { role: "img", "aria-label": `${title}, of the base and each foot` }),
      over: element("canvas", { class: "over", "aria-hidden": "true" }),
    }));
    list();
    byId("histories-key").replaceChildren(
      ...app.table.about.legs.slice(0, shown[0]?.reel.model.feet.length ?? 0).map((colour, leg) => {
        const swatch = element("span", { class: "leg", "aria-hidden": "true" });
        swatch.style.background = colour;
        return element("span", {}, swatch, ` leg ${leg + 1}`);
      }),
    );
  };
  /** Put the panels of the chosen group into the page. */
  const list = () => {
    const listed = [...panels.filter((_, k) => isListed(k)), ...(choice.value === "policy" ? [] : maps)];
    root.replaceChildren(...listed.map(({ base, over }) => element("div", { class: "history" }, base, over)));
  };

  const nearer = { "aria-label": "zoom in, in time", title: "zoom in about the present time" };
  const farther = { "aria-label": "zoom out, in time", title: "zoom out" };
  const whole = makeButton({ id: "histories-all" }, () => zoomTo(null), "all of the time");
  whole.disabled = !span;
  const zoom = element(
    "span",
    { class: "plain", role: "group", "aria-label": "zoom in time" },
    makeButton(nearer, () => zoomBy(0.5), "+"),
    makeButton(farther, () => zoomBy(2), "−"),
    whole,
  );
  root.before(element("div", { class: "controls" }, choiceLabel, zoom));
  choice.addEventListener("change", () => {
    list();
    draw();
  });
  box.addEventListener("toggle", draw);
  window.addEventListener("scroll", () => point(time), { passive: true }); // cursors of panels that come into view
  return {
    show: (reels, length) => {
      total = length;
      if (span && (span[0] >= total || span[1] > total * 1.001)) span = null;
      shown = reels.flatMap((reel) => {
        if (!reel) return [];
        const paths = replayPaths(reel, freeJointIndex(reel.model), MIN_STEPS);
        return [{ reel, histories: replaySeries(reel, paths), paths }];
      });
      lay();
      draw();
    },
    draw,
    point,
    span: () => span,
  };
}
