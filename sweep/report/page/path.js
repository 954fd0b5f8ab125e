// Ways of base and feet in space: from above and from the side, a mark where the replay is.
import { sheetOf, straight } from "./dom.js";
import { frameAt, plus, posesOf, rotated } from "./kinematics.js";
import { shortly, ticks } from "./numbers.js";

/** @import { Sheet, Theme } from "./dom.js" */
/** @import { Model, Motion } from "./kinematics.js" */
/** @import { App } from "./main.js" */
/** @typedef {{ model: Model, motion: Motion }} Reel */

/**
 * Where base and feet are in each frame, m.
 * @typedef {object} Paths
 * @property {number[][]} base nothing where the robot has no free joint
 * @property {number[][][]} feet by leg
 * @property {[number, number][]} ends of x, y and z, of all these
 */

export const BESIDE = { left: 44, right: 8, top: 20, bottom: 20 }; // a panel, CSS pixels
export const FACES = /** @type {const} */ ([
  { title: "way from above: y over x [m]", up: 1 },
  { title: "way from the side: z over x [m]", up: 2 },
]);

/**
 * @param {Reel} reel
 * @param {number} free where the base is among the coordinates, -1 where it is not free
 * @returns {Paths}
 */
export function pathsOf({ model, motion }, free) {
  const { frames, coordinates, qpos } = motion;
  /** @type {Paths} */
  const found = { base: [], feet: model.feet.map(() => []), ends: [] };
  for (let k = 0; k < frames; k++) {
    const state = qpos.subarray(k * coordinates, (k + 1) * coordinates);
    if (free >= 0) found.base.push(Array.from(state.subarray(free, free + 3)));
    if (!model.feet.length) continue;
    const poses = posesOf(model, state);
    model.feet.forEach(([body, ...place], leg) =>
      found.feet[leg].push(plus(poses[body].pos, rotated(poses[body].turn, place))),
    );
  }
  const places = [found.base, ...found.feet].flat();
  found.ends = [0, 1, 2].map((part) => endsOf(places.map((place) => place[part])));
  return found;
}

/**
 * The least and the greatest.
 * @type {(values: number[]) => [number, number]}
 */
const endsOf = (values) =>
  values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);

/**
 * From metres to a canvas, the same in both directions, all of some paths being on it.
 * @param {Paths[]} paths
 * @param {number} up 1 for y, 2 for z
 * @param {number} width CSS pixels
 * @param {number} height
 * @returns {{ spot: (place: number[]) => [number, number], ends: [number, number][] }} ends of x and of the other
 */
export function laidOut(paths, up, width, height) {
  const [wide, high] = [width - BESIDE.left - BESIDE.right, height - BESIDE.top - BESIDE.bottom];
  const ends = [0, up].map((part) => {
    const [low, high] = endsOf(paths.flatMap((one) => one.ends[part]));
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
      BESIDE.left + (place[0] - shown[0][0]) * scale,
      height - BESIDE.bottom - (place[up] - shown[1][0]) * scale,
    ]);
  return { spot, ends: shown };
}

/** @typedef {{ at: number, text: string }} Tick in CSS pixels */

/**
 * What is around a panel: lines across it with numbers on the left, numbers below, and a title.
 * @type {(sheet: Sheet, theme: Theme, across: Tick[], below: Tick[], title: string, room: number) => void}
 */
export function drawRuled({ pen, width, height }, { ink, soft, line }, across, below, title, room) {
  pen.font = pen.font.replace(/\d+px/, "11px");
  pen.fillStyle = soft;
  pen.strokeStyle = line;
  pen.lineWidth = 1;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const { at, text } of across) {
    straight(pen, BESIDE.left, at, width - BESIDE.right, at);
    pen.fillText(text, BESIDE.left - 5, at, BESIDE.left - 8);
  }
  pen.textAlign = "center";
  pen.textBaseline = "top";
  for (const { at, text } of below) pen.fillText(text, at, height - BESIDE.bottom + 4);
  pen.textAlign = "left";
  pen.fillStyle = ink;
  pen.fillText(title, BESIDE.left, 3, room);
}

/**
 * @param {App} app
 * @param {HTMLCanvasElement} canvas
 * @param {Paths[]} paths of the replay, and dashed of one beside it
 * @param {(typeof FACES)[number]} side
 */
export function drawPaths(app, canvas, paths, { title, up }) {
  const sheet = sheetOf(canvas);
  const { pen, width, height } = sheet;
  const { spot, ends } = laidOut(paths, up, width, height);
  const across = ticks(...ends[1], 4).map((one) => ({ at: spot([0, one, one])[1], text: shortly(one) }));
  const below = ticks(...ends[0], width / 90).map((one) => ({ at: spot([one, 0, 0])[0], text: shortly(one) }));
  drawRuled(sheet, app.theme(), across, below, title, width - BESIDE.left);
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
 * Where the base, or else each foot, is at a time.
 * @param {App} app
 * @param {HTMLCanvasElement} canvas
 * @param {Paths[]} paths
 * @param {(typeof FACES)[number]} side
 * @param {Motion} motion of the first of them
 * @param {number} time s
 */
export function pointPaths(app, canvas, paths, { up }, motion, time) {
  const { pen, width, height } = sheetOf(canvas);
  const { spot } = laidOut(paths, up, width, height);
  const place = paths[0].base[frameAt(motion, time)];
  if (!place) return;
  pen.fillStyle = app.theme().ink;
  pen.beginPath();
  pen.arc(...spot(place), 4, 0, 2 * Math.PI);
  pen.fill();
}
