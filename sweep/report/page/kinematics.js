// Decoding of a replay's states, and forward kinematics of its bodies.

/** @import { Shown } from "./data.js" */

/**
 * @typedef {object} Body
 * @property {number} parent
 * @property {number[]} pos
 * @property {number[]} quat w, x, y, z
 * @property {number[][]} joints
 */

/**
 * @typedef {object} Geom
 * @property {number} body
 * @property {boolean} robot
 * @property {number[]} pos
 * @property {number[]} quat
 * @property {[number, number, number]} colour
 * @property {"plane" | "sphere" | "capsule" | "cylinder" | "box" | "mesh" | "field"} shape
 * @property {number[]} [size]
 * @property {number} [mesh] number among the model's meshes
 * @property {number[][]} [vertices]
 * @property {number[][]} [faces]
 * @property {number[]} [x] of a height field's points
 * @property {number[]} [y]
 * @property {number[]} [heights] row by row, a row for each y
 */

/**
 * @typedef {object} Model
 * @property {Body[]} bodies
 * @property {Geom[]} geoms
 * @property {number[][]} feet
 * @property {{ vertices: number[][], faces: number[][] }[]} [meshes] missing in replays of earlier versions
 * @property {number[]} hinges addresses of hinges and slides
 * @property {string[]} [hinge_names] missing in replays of earlier versions
 */

/**
 * Give geoms the vertices and faces of their meshes.
 * @type {(model: Model) => Model}
 */
export function withMeshes(model) {
  const geoms = model.geoms.map((geom) => (geom.mesh === undefined ? geom : { ...geom, ...model.meshes?.[geom.mesh] }));
  return { ...model, geoms };
}

/** @typedef {{ body: number, point: number[], force: number[], start: number, end: number }} Push N and s */
/** @typedef {{ title: string, names: string[], lines: Float64Array[], resolution: number }} Signal */

/**
 * @typedef {object} Motion
 * @property {number} step s between frames, and time of the first
 * @property {number} frames
 * @property {number} coordinates
 * @property {Float64Array} qpos frame by frame
 * @property {Float64Array} force of the feet, N, three a foot and frame
 * @property {Int16Array} stage
 * @property {Float64Array | null} torque of the hinges, N m, frame by frame; null in replays of earlier versions
 * @property {number | null} torqueLimit N m
 * @property {Float64Array | null} margin to the nearest threshold; null in replays of earlier versions
 * @property {string[]} limits name of this threshold in each frame
 * @property {Float64Array | null} friction share of the available friction that each foot uses; null in replays of earlier versions
 * @property {Signal[]} signals what a learned policy saw and did
 * @property {Push[]} pushes
 * @property {{ qpos: number[], force: number, torque: number, margin: number, friction: number }} steps in which values are stored
 */

/**
 * Decode columns of integers from byte planes: differences from frame to frame, the low bytes of a column first.
 * @param {Uint8Array} bytes
 * @param {number} frames
 * @param {number} columns
 * @param {1 | 2} size bytes of a number
 * @returns {Int16Array} frame by frame
 */
export function readPlanes(bytes, frames, columns, size) {
  const values = new Int16Array(frames * columns);
  for (let column = 0; column < columns; column++) {
    const start = column * size * frames;
    let sum = 0;
    for (let frame = 0; frame < frames; frame++) {
      const low = bytes[start + frame];
      sum += size === 2 ? low | (bytes[start + frames + frame] << 8) : low;
      values[frame * columns + column] = size === 2 ? sum : (sum << 24) >> 24;
    }
  }
  return values;
}

/**
 * @param {Shown} shown
 * @param {Model} model
 * @param {ArrayBuffer} buffer of its stream
 * @returns {Motion}
 */
export function readMotion(shown, model, buffer) {
  const { frames, scales } = shown;
  const coordinates = scales.length;
  const bytes = new Uint8Array(buffer);
  const states = readPlanes(bytes, frames, coordinates, 2);
  const forces = 3 * model.feet.length;
  const torques = shown.torque_scale ? model.hinges.length : 0;
  const margins = forces + 1 + torques; // follow the feet's forces and the stage
  const shares = margins + (shown.limits.length ? 2 : 0);
  const feet = shown.friction_scale ? model.feet.length : 0;
  const told = shares + feet;
  const wide = told + signalsOf(shown).reduce((sum, { names }) => sum + names.length, 0);
  const small = readPlanes(bytes.subarray(2 * frames * coordinates), frames, wide, 1);
  const qpos = Float64Array.from(states, (value, k) => value * scales[k % coordinates]);
  const force = new Float64Array(forces * frames);
  const stage = new Int16Array(frames);
  const torque = torques ? new Float64Array(torques * frames) : null;
  const margin = shown.limits.length ? new Float64Array(frames) : null;
  const limits = [];
  const friction = feet ? new Float64Array(feet * frames) : null;
  for (let frame = 0; frame < frames; frame++) {
    const of = small.subarray(frame * wide, (frame + 1) * wide);
    for (let k = 0; k < forces; k++) force[frame * forces + k] = of[k] * shown.force_scale;
    stage[frame] = of[forces];
    for (let k = 0; torque && k < torques; k++) torque[frame * torques + k] = of[forces + 1 + k] * shown.torque_scale;
    for (let k = 0; friction && k < feet; k++) friction[frame * feet + k] = of[shares + k] * shown.friction_scale;
    if (!margin) continue;
    margin[frame] = of[margins] * shown.margin_scale;
    limits.push(shown.limits[of[margins + 1]]);
  }
  let column = told;
  const signals = signalsOf(shown).map(({ title, names, middles, steps }) => {
    const lines = names.map((_, line) => {
      const place = column + line;
      return Float64Array.from({ length: frames }, (_, k) => middles[line] + steps[line] * small[k * wide + place]);
    });
    column += names.length;
    return { title, names: names.filter(Boolean), lines, resolution: Math.max(...steps) };
  });
  const steps = {
    qpos: scales,
    force: shown.force_scale,
    torque: shown.torque_scale,
    margin: shown.margin_scale,
    friction: shown.friction_scale,
  };
  return {
    ...{ step: shown.step, frames, coordinates, qpos, force, stage, torque, torqueLimit: shown.torque_limit },
    ...{ margin, limits, friction, signals, pushes: shown.pushes ?? [], steps },
  };
}

/** @type {(shown: Shown) => NonNullable<Shown["signals"]>} */
const signalsOf = ({ signals }) => signals ?? [];

/**
 * Time of the last frame, s.
 * @type {(motion: Motion) => number}
 */
export function endTime(motion) {
  return motion.step * motion.frames;
}

/**
 * Index of the frame shown at a time.
 * @type {(motion: Motion, time: number) => number}
 */
export function frameAt(motion, time) {
  return Math.max(0, Math.min(motion.frames - 1, Math.round(time / motion.step) - 1));
}

/**
 * Yield the stages of a motion in order.
 * @type {(motion: Motion) => Generator<{ stage: number, from: number, to: number }>} s, when each begins and ends
 */
export function* stageSpans({ stage, frames, step }) {
  for (let from = 0, to = 0; from < frames; from = to) {
    while (to < frames && stage[to] === stage[from]) to++;
    yield { stage: stage[from], from: from * step, to: to * step };
  }
}

/**
 * Coordinates at a time (s), interpolated by a Catmull-Rom cubic through the four frames around it.
 * @type {(motion: Motion, time: number) => Float64Array}
 */
export function stateAt(motion, time) {
  const { frames, coordinates, qpos } = motion;
  const place = Math.max(0, Math.min(frames - 1, time / motion.step - 1));
  const k = Math.min(Math.floor(place), Math.max(0, frames - 2));
  const u = place - k;
  const at = [k - 1, k, k + 1, k + 2].map((frame) => Math.max(0, Math.min(frames - 1, frame)) * coordinates);
  const weights = [
    ((2 - u) * u - 1) * u * 0.5,
    ((3 * u - 5) * u * u + 2) * 0.5,
    ((4 - 3 * u) * u + 1) * u * 0.5,
    (u - 1) * u * u * 0.5,
  ];
  const state = new Float64Array(coordinates);
  for (let c = 0; c < coordinates; c++) for (let j = 0; j < 4; j++) state[c] += weights[j] * qpos[at[j] + c];
  return state;
}

/**
 * Rotation matrix, row by row, of a quaternion w, x, y, z of any norm.
 * @type {(quat: ArrayLike<number>) => number[]}
 */
export function rotationMatrix(quat) {
  const size = Math.hypot(quat[0], quat[1], quat[2], quat[3]) || 1;
  const [w, x, y, z] = [quat[0] / size, quat[1] / size, quat[2] / size, quat[3] / size];
  return [
    1 - 2 * (y * y + z * z),
    2 * (x * y - w * z),
    2 * (x * z + w * y),
    2 * (x * y + w * z),
    1 - 2 * (x * x + z * z),
    2 * (y * z - w * x),
    2 * (x * z - w * y),
    2 * (y * z + w * x),
    1 - 2 * (x * x + y * y),
  ];
}

/**
 * Product of two 3 x 3 matrices.
 * @type {(a: number[], b: number[]) => number[]}
 */
export function multiplyMatrices(a, b) {
  const made = new Array(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) made[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
  return made;
}

/** @type {(turn: number[], v: ArrayLike<number>) => number[]} */
export function rotateVector(turn, v) {
  return [0, 3, 6].map((i) => turn[i] * v[0] + turn[i + 1] * v[1] + turn[i + 2] * v[2]);
}

/**
 * a + times b
 * @type {(a: ArrayLike<number>, b: ArrayLike<number>, times?: number) => number[]}
 */
export function addScaled(a, b, times = 1) {
  return [a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]];
}

/** @type {(a: ArrayLike<number>, b: ArrayLike<number>) => number} */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** @typedef {{ pos: number[], turn: number[] }} Pose */

/**
 * Poses of all bodies by MuJoCo's forward kinematics.
 * @type {(model: Model, state: Float64Array) => Pose[]}
 */
export function bodyPoses(model, state) {
  /** @type {Pose[]} */
  const poses = [];
  for (const body of model.bodies) {
    const parent = poses[body.parent] ?? { pos: [0, 0, 0], turn: [1, 0, 0, 0, 1, 0, 0, 0, 1] };
    let pos = addScaled(parent.pos, rotateVector(parent.turn, body.pos));
    let turn = multiplyMatrices(parent.turn, rotationMatrix(body.quat));
    for (const [address, ...joint] of body.joints) {
      if (!joint.length) {
        pos = Array.from(state.subarray(address, address + 3));
        turn = rotationMatrix(state.subarray(address + 3, address + 7));
        continue;
      }
      const axis = joint.slice(0, 3);
      if (joint.length < 6) {
        pos = addScaled(pos, rotateVector(turn, axis), state[address] - (joint[3] ?? 0)); // slide joint
        continue;
      }
      const anchor = joint.slice(3, 6);
      const fixed = addScaled(pos, rotateVector(turn, anchor));
      const half = (state[address] - (joint[6] ?? 0)) / 2;
      const about = axis.some((part) => part)
        ? [Math.cos(half), ...axis.map((part) => part * Math.sin(half))]
        : state.subarray(address, address + 4); // ball joint
      turn = multiplyMatrices(turn, rotationMatrix(about));
      pos = addScaled(fixed, rotateVector(turn, anchor), -1);
    }
    poses.push({ pos, turn });
  }
  return poses;
}
