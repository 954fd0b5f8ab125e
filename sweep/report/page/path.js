// Paths of base and feet from above and from the side, with a mark at the present time.
import { prepareCanvas, drawLine } from "./dom.js";
import { frameAt, addScaled, bodyPoses, rotateVector } from "./kinematics.js";
import { formatShort, ticks } from "./numbers.js";

/** @import { Sheet, Theme } from "./dom.js" */
/** @import { Model, Motion } from "./kinematics.js" */
/** @import { App } from "./main.js" */
/** @typedef {{ model: Model, motion: Motion }} Reel */

/**
 * Positions of base and feet in each frame, m.
 * @typedef {object} Paths
 * @property {number[][]} base empty if the robot has no free joint
 * @property {number[][][]} feet by leg
 * @property {[number, number][]} ends ranges of x, y and z over all of these
 */

export const PANEL_MARGIN = { left: 44, right: 8, top: 34, bottom: 20 }; // of a panel, CSS pixels
export const PATH_VIEWS = /** @type {const} */ ([
  { title: "path from above: y over x [m]", up: 1 },
  { title: "path from the side: z over x [m]", up: 2 },
]);

/**
 * @param {Reel} reel
 * @param {number} free index of the base among the coordinates, -1 without a free joint
 * @param {number} minSteps steps of the stored positions that the ranges span at least
 * @returns {Paths}
 */
export function replayPaths({ model, motion }, free, minSteps) {
  const { frames, coordinates, qpos } = motion;
  /** @type {Paths} */
  const found = { base: [], feet: model.feet.map(() => []), ends: [] };
  for (let k = 0; k < frames; k++) {
    const state = qpos.subarray(k * coordinates, (k + 1) * coordinates);
    if (free >= 0) found.base.push(Array.from(state.subarray(free, free + 3)));
    if (!model.feet.length) continue;
    const poses = bodyPoses(model, state);
    model.feet.forEach(([body, ...place], leg) =>
      found.feet[leg].push(addScaled(poses[body].pos, rotateVector(poses[body].turn, place))),
    );
  }
  const places = [found.base, ...found.feet].flat();
  found.ends = [0, 1, 2].map((part) => {
    const [low, high] = minAndMax(places.map((place) => place[part]));
    const missing = Math.max(0, minSteps * motion.steps.qpos[Math.max(free, 0) + part] - (high - low)) / 2;
    return [low - missing, high + missing];
  });
  return found;
}

/**
 * Minimum and maximum.
 * @type {(values: number[]) => [number, number]}
 */
const minAndMax = (values) =>
  values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);

/**
 * Fit paths into a canvas with one scale for both axes.
 * @param {Paths[]} paths
 * @param {number} up 1 for y, 2 for z
 * @param {number} width CSS pixels
 * @param {number} height
 * @returns {{ spot: (place: number[]) => [number, number], ends: [number, number][] }} ends of x and of the other
 */
export function fitPaths(paths, up, width, height) {
  const [wide, high] = [
    width - PANEL_MARGIN.left - PANEL_MARGIN.right,
    height - PANEL_MARGIN.top - PANEL_MARGIN.bottom,
  ];
  const ends = [0, up].map((part) => {
    const [low, high] = minAndMax(paths.flatMap((one) => one.ends[part]));
    return high > low ? [low, high] : [low - 0.5, low + 0.5];
  });
  const [x, y] = ends;
  const scale = 0.96 * Math.min(wide / (x[1] - x[0]), high / (y[1] - y[0]));
  const middle = ends.map(([low, high]) => (low + high) / 2);
  const shown = [wide, high].map(
    (size, k) => /** @type {[number, number]} */ ([middle[k] - size / scale / 2, middle[k] + size / scale / 2]),
  );
  const spot = (/** @type {number[]} */ place) =>
    /** @type {[number, number]} */ ([
      PANEL_MARGIN.left + (place[0] - shown[0][0]) * scale,
      height - PANEL_MARGIN.bottom - (place[up] - shown[1][0]) * scale,
    ]);
  return { spot, ends: shown };
}

/** @typedef {{ at: number, text: string }} Tick in CSS pixels */

/**
 * Draw the frame of a panel: horizontal lines with numbers on the left, numbers below, and a title.
 * @type {(sheet: Sheet, theme: Theme, across: Tick[], below: Tick[], title: string, room: number) => void}
 */
export function drawRuledFrame({ pen, width, height }, { ink, soft, line }, across, below, title, room) {
  pen.font = pen.font.replace(/\d+px/, "11px");
  pen.fillStyle = soft;
  pen.strokeStyle = line;
  pen.lineWidth = 1;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const { at, text } of across) {
    drawLine(pen, PANEL_MARGIN.left, at, width - PANEL_MARGIN.right, at);
    pen.fillText(text, PANEL_MARGIN.left - 5, at, PANEL_MARGIN.left - 8);
  }
  pen.textAlign = "center";
  pen.textBaseline = "top";
  for (const { at, text } of below) pen.fillText(text, at, height - PANEL_MARGIN.bottom + 4);
  pen.textAlign = "left";
  pen.fillStyle = ink;
  pen.fillText(title, PANEL_MARGIN.left, 3, room);
}

/**
 * @param {App} app
 * @param {HTMLCanvasElement} canvas
 * @param {Paths[]} paths of the replay, and dashed of a second one
 * @param {(typeof PATH_VIEWS)[number]} side
 */
export function drawPaths(app, canvas, paths, { title, up }) {
  const sheet = prepareCanvas(canvas);
  const { pen, width, height } = sheet;
  const { spot, ends } = fitPaths(paths, up, width, height);
  const across = ticks(...ends[1], 4).map((one) => ({ at: spot([0, one, one])[1], text: formatShort(one) }));
  const below = ticks(...ends[0], width / 90).map((one) => ({ at: spot([one, 0, 0])[0], text: formatShort(one) }));
  drawRuledFrame(sheet, app.theme(), across, below, title, width - PANEL_MARGIN.left);
  paths.forEach(({ base, feet }, number) => {
    pen.setLineDash(number ? [4, 3] : []);
    [...feet, base].forEach((places, leg) => {
      pen.strokeStyle = leg < feet.length ? app.table.about.legs[leg % app.table.about.legs.length] : app.theme().ink;
      pen.lineWidth = leg < feet.length ? 1 : 1.6;
      pen.beginPath();
      for (const place of places) pen.lineTo(...spot(place));
      pen.stroke();
    });
  });
  pen.setLineDash([]);
}

/**
 * Mark the position of the base, or else of each foot, at a time.
 * @param {App} app
 * @param {HTMLCanvasElement} canvas
 * @param {Paths[]} paths
 * @param {(typeof PATH_VIEWS)[number]} side
 * @param {Motion} motion of the first of them
 * @param {number} time s
 */
export function pointPaths(app, canvas, paths, { up }, motion, time) {
  const { pen, width, height } = prepareCanvas(canvas);
  const { spot } = fitPaths(paths, up, width, height);
  const place = paths[0].base[frameAt(motion, time)];
  if (!place) return;
  pen.fillStyle = app.theme().ink;
  pen.beginPath();
  pen.arc(...spot(place), 4, 0, 2 * Math.PI);
  pen.fill();
}
