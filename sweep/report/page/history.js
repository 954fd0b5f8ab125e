// Plots of a replay over time: margin, forces, friction, torques, joints, base and slip, with stages and the present time.
import { byId, element, pointerPosition, prepareCanvas, drawLine } from "./dom.js";
import { frameAt, addScaled, stageSpans, rotationMatrix } from "./kinematics.js";
import { clamp, formatShort, ticks } from "./numbers.js";
import { PANEL_MARGIN, drawPaths, drawRuledFrame, replayPaths, pointPaths, PATH_VIEWS } from "./path.js";

/** @import { Model, Motion } from "./kinematics.js" */
/** @import { App } from "./main.js" */
/** @import { Paths, Reel } from "./path.js" */

/**
 * Lines over time in one panel.
 * @typedef {object} Histories
 * @property {string} title with the unit
 * @property {Float64Array[]} lines a value for each frame; of legs in their order
 * @property {number | null} limit that the lines are held by, on both sides of zero
 * @property {string[]} [limitNames] nearest threshold in each frame
 */

const LOADED_FORCE = 1; // N, force from which a foot is in stance

/**
 * Time series of a replay.
 * @type {(reel: Reel, paths: Paths) => Histories[]}
 */
export function replaySeries({ model, motion }, paths) {
  const { frames, coordinates, qpos, force, torque, friction } = motion;
  const over = (/** @type {(frame: number) => number} */ value) =>
    Float64Array.from({ length: frames }, (_, k) => value(k));
  const legs = (/** @type {(frame: number, leg: number) => number} */ value) =>
    model.feet.map((_, leg) => over((frame) => value(frame, leg)));
  const free = freeJointIndex(model);
  const tilt = (/** @type {number} */ k) => {
    const upright = rotationMatrix(qpos.subarray(k * coordinates + free + 3, k * coordinates + free + 7))[8];
    return (Math.acos(clamp(upright, -1, 1)) * 180) / Math.PI;
  };
  const pull = (/** @type {number} */ k, /** @type {number} */ leg) => {
    const first = 3 * (k * model.feet.length + leg);
    const [x, y, z] = force.subarray(first, first + 3);
    return Math.hypot(x, y, z);
  };
  const many = model.hinges.length;
  const kinds = model.feet.length ? ["α", "β", "γ"] : []; // of a leg's joints
  const joints = kinds.map((name, kind) => ({
    title: `joint ${name} [°]`,
    lines: legs((k, leg) => (qpos[k * coordinates + model.hinges[3 * leg + kind]] * 180) / Math.PI),
    limit: null,
  }));
  const torques = kinds.map((name, kind) => ({
    title: `torque of ${name} [N·m]`,
    lines: torque ? legs((k, leg) => torque[many * k + 3 * leg + kind]) : [],
    limit: motion.torqueLimit,
  }));
  if (!kinds.length) {
    const each = (/** @type {(frame: number, joint: number) => number} */ value) =>
      model.hinges.map((_, joint) => over((frame) => value(frame, joint)));
    const all = torque ? each((k, joint) => torque[many * k + joint]) : [];
    torques.push({ title: "torque of the joints [N·m]", lines: all, limit: motion.torqueLimit });
    joints.push({
      title: "joints [rad]",
      lines: each((k, joint) => qpos[k * coordinates + model.hinges[joint]]),
      limit: null,
    });
  }
  const found = [
    {
      title: "margin to the nearest limit",
      lines: motion.margin ? [motion.margin] : [],
      limit: motion.margin ? 0 : null,
      limitNames: motion.limits,
    },
    { title: "force on a foot [N]", lines: legs(pull), limit: null },
    {
      title: "used share of a foot's available friction",
      lines: friction ? legs((k, leg) => friction[model.feet.length * k + leg]) : [],
      limit: 1,
    },
    { title: "slip of a standing foot [m]", lines: footSlips(paths.feet, pull), limit: null },
    { title: "height of a foot [m]", lines: paths.feet.map((foot) => over((k) => foot[k][2])), limit: null },
    ...["x of the base [m]", "y of the base [m]", "height of the base [m]"].map((title, part) => ({
      title,
      lines: free < 0 ? [] : [over((k) => paths.base[k][part])],
      limit: null,
    })),
    { title: "tilt of the base [°]", lines: free < 0 ? [] : [over(tilt)], limit: null },
    ...torques,
    ...joints,
  ];
  return found.filter(({ lines }) => lines.length);
}

/**
 * Index of the robot's free joint among the coordinates, -1 without one.
 * @type {(model: Model) => number}
 */
function freeJointIndex({ bodies, geoms }) {
  let body = geoms.find(({ robot }) => robot)?.body ?? 0;
  while (body && bodies[body].joints[0]?.length !== 1) body = bodies[body].parent;
  return bodies[body].joints[0]?.length === 1 ? bodies[body].joints[0][0] : -1;
}

/**
 * Distance of each loaded foot from its touchdown.
 * @param {number[][][]} feet positions by leg and frame
 * @param {(frame: number, leg: number) => number} pull
 * @returns {Float64Array[]} m
 */
function footSlips(feet, pull) {
  return feet.map((foot, leg) => {
    const way = new Float64Array(foot.length);
    for (let k = 1; k < foot.length; k++) {
      const stood = pull(k, leg) > LOADED_FORCE && pull(k - 1, leg) > LOADED_FORCE;
      way[k] = stood ? way[k - 1] + Math.hypot(...addScaled(foot[k], foot[k - 1], -1)) : 0;
    }
    return way;
  });
}

/**
 * Panels below the replay.
 * @param {App} app
 * @param {(time: number) => void} to jumps to a time
 * @returns {{ show: (reels: (Reel | null)[], total: number) => void, draw: () => void, point: (time: number) => void }}
 */
export function historyView(app, to) {
  const root = byId("histories");
  const box = /** @type {HTMLDetailsElement} */ (byId("histories-box"));
  /** @type {{ base: HTMLCanvasElement, over: HTMLCanvasElement }[]} */
  let panels = [];
  /** @type {{ base: HTMLCanvasElement, over: HTMLCanvasElement }[]} of paths */
  let maps = [];
  /** @type {{ reel: Reel, histories: Histories[], paths: Paths }[]} */
  let shown = [];
  let total = 1;
  let time = 0;
  /** @type {Map<HTMLCanvasElement, string>} what cursors show: where they are, and words */
  const pointed = new Map();

  const xOf = (/** @type {number} */ at, /** @type {number} */ width) =>
    PANEL_MARGIN.left + (at / total) * (width - PANEL_MARGIN.left - PANEL_MARGIN.right);

  const draw = () => {
    if (!box.open || !shown.length) return;
    panels.forEach(({ base }, k) => drawPanel(base, k));
    const paths = shown.map((one) => one.paths);
    maps.forEach(({ base }, k) => drawPaths(app, base, paths, PATH_VIEWS[k]));
    pointed.clear();
    point(time);
  };

  /** @type {(canvas: HTMLCanvasElement, k: number) => void} */
  const drawPanel = (canvas, k) => {
    const sheet = prepareCanvas(canvas);
    const { pen, width, height } = sheet;
    const { ink, line } = app.theme();
    const colours = app.table.about.legs;
    const [top, bottom] = [PANEL_MARGIN.top, height - PANEL_MARGIN.bottom];
    const [first] = shown;
    pen.fillStyle = line;
    for (const { stage, from, to } of stageSpans(first.reel.motion)) {
      pen.globalAlpha = stage % 2 ? 0.34 : 0.1;
      const left = xOf(from, width);
      pen.fillRect(left, top, xOf(to, width) - left, bottom - top);
    }
    pen.globalAlpha = 1;
    const { title, limit, limitNames } = first.histories[k];
    const like = shown.map(({ histories }) => histories.find((other) => other.title === title)?.lines ?? []);
    const lines = like.flat();
    let [low, high] = [Infinity, -Infinity];
    for (const values of lines) for (const value of values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    const reached = limit !== null && Math.max(-low, high) > 0.6 * limit;
    if (reached) [low, high] = [low < 0 ? Math.min(low, -limit) : low, Math.max(high, limit)];
    if (!(high > low)) [low, high] = [low - 0.5 || -0.5, high + 0.5 || 0.5];
    const room = 0.04 * (high - low);
    const yOf = (/** @type {number} */ value) =>
      bottom - ((value - low + room) / (high - low + 2 * room)) * (bottom - top);
    const across = ticks(low, high, 4).map((value) => ({ at: yOf(value), text: formatShort(value) }));
    const below = ticks(0, total, width / 90).map((at) => ({ at: xOf(at, width), text: `${formatShort(at)} s` }));
    drawRuledFrame(sheet, app.theme(), across, below, title, width / (limitNames ? 2 : 1) - PANEL_MARGIN.left);
    if (limit !== null && reached) {
      pen.strokeStyle = ink;
      pen.setLineDash([2, 3]);
      for (const at of low < 0 ? [limit, -limit] : [limit])
        drawLine(pen, PANEL_MARGIN.left, yOf(at), width - PANEL_MARGIN.right, yOf(at));
    }
    shown.forEach(({ reel }, number) => {
      const own = like[number];
      pen.setLineDash(number ? [4, 3] : []);
      own.forEach((values, leg) => {
        pen.strokeStyle = own.length > 1 ? colours[leg % colours.length] : ink;
        pen.lineWidth = 1.2;
        pen.beginPath();
        values.forEach((value, frame) => pen.lineTo(xOf((frame + 1) * reel.motion.step, width), yOf(value)));
        pen.stroke();
      });
    });
    pen.setLineDash([]);
  };

  /** @param {number} now */
  const point = (now) => {
    time = now;
    if (!box.open || !shown.length) return;
    const paths = shown.map((one) => one.paths);
    maps.forEach(({ over }, k) => {
      if (app.visible(over)) pointPaths(app, over, paths, PATH_VIEWS[k], shown[0].reel.motion, time);
    });
    panels.forEach(({ over }, k) => {
      if (!app.visible(over)) return;
      const [{ reel, histories }] = shown;
      const { limitNames, lines } = histories[k];
      const frame = frameAt(reel.motion, time);
      const words = limitNames ? `${limitNames[frame]} ${formatShort(lines[0][frame])}` : "";
      const x = Math.round(xOf(time, over.clientWidth));
      if (pointed.get(over) === `${x} ${words}`) return; // most frames of a long replay move it by less than a pixel
      pointed.set(over, `${x} ${words}`);
      const { pen, width, height } = prepareCanvas(over);
      pen.fillStyle = app.theme().ink;
      pen.fillRect(x - 0.75, PANEL_MARGIN.top, 1.5, height - PANEL_MARGIN.top - PANEL_MARGIN.bottom);
      pen.font = pen.font.replace(/\d+px/, "11px");
      pen.textAlign = "right";
      pen.textBaseline = "top";
      pen.fillText(words, width - PANEL_MARGIN.right, 3, width / 2);
    });
  };

  const lay = () => {
    panels = (shown[0]?.histories ?? []).map(({ title }) => {
      const each = shown[0].reel.model.feet.length ? "leg" : "joint";
      const label = `${title} over time, a line for each ${each}; drag to go to a time`;
      const base = element("canvas", { role: "img", "aria-label": label });
      const over = element("canvas", { class: "over", "aria-hidden": "true" });
      const scrub = (/** @type {PointerEvent} */ event) =>
        to(
          ((pointerPosition(event, over)[0] - PANEL_MARGIN.left) /
            (over.clientWidth - PANEL_MARGIN.left - PANEL_MARGIN.right)) *
            total,
        );
      over.addEventListener("pointerdown", (event) => {
        over.setPointerCapture(event.pointerId);
        scrub(event);
      });
      over.addEventListener("pointermove", (event) => event.buttons && scrub(event));
      return { base, over };
    });
    const moves = shown[0]?.paths.base.length;
    maps = (moves ? PATH_VIEWS : []).map(({ title }) => ({
      base: element("canvas", { role: "img", "aria-label": `${title}, of the base and each foot` }),
      over: element("canvas", { class: "over", "aria-hidden": "true" }),
    }));
    root.replaceChildren(
      ...[...panels, ...maps].map(({ base, over }) => element("div", { class: "history" }, base, over)),
    );
    byId("histories-key").replaceChildren(
      ...app.table.about.legs.slice(0, shown[0]?.reel.model.feet.length ?? 0).map((colour, leg) => {
        const swatch = element("span", { class: "leg", "aria-hidden": "true" });
        swatch.style.background = colour;
        return element("span", {}, swatch, ` leg ${leg + 1}`);
      }),
    );
  };

  box.addEventListener("toggle", draw);
  return {
    show: (reels, length) => {
      total = length;
      shown = reels.flatMap((reel) => {
        if (!reel) return [];
        const paths = replayPaths(reel, freeJointIndex(reel.model));
        return [{ reel, histories: replaySeries(reel, paths), paths }];
      });
      lay();
      draw();
    },
    draw,
    point,
  };
}
