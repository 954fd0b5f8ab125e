// Time series of a replay: margin, forces, friction, torques, joints, base and slip, and what a learned policy saw and did.
import { addScaled, rotationMatrix } from "./kinematics.js";
import { clamp } from "./numbers.js";

/** @import { Model, Motion } from "./kinematics.js" */
/** @import { Paths, Reel } from "./path.js" */

/**
 * Lines over time in one panel.
 * @typedef {object} Histories
 * @property {string} title with the unit
 * @property {Float64Array[]} lines a value for each frame; of legs in their order
 * @property {string[]} names of the lines; empty for a single one
 * @property {number} resolution step in which the values are stored
 * @property {"robot" | "policy"} group
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
  const legNames = model.feet.map((_, leg) => `leg ${leg + 1}`);
  const jointNames = model.hinges.map((_, joint) => model.hinge_names?.[joint] ?? `joint ${joint + 1}`);
  const { steps } = motion;
  const turn = Math.max(...model.hinges.map((address) => steps.qpos[address]), 0);
  const place = free < 0 ? turn : steps.qpos[free];
  const joints = kinds.map((name, kind) => ({
    title: `joint ${name} [°]`,
    lines: legs((k, leg) => (qpos[k * coordinates + model.hinges[3 * leg + kind]] * 180) / Math.PI),
    limit: null,
    names: legNames,
    resolution: (turn * 180) / Math.PI,
  }));
  const torques = kinds.map((name, kind) => ({
    title: `torque of ${name} [N·m]`,
    lines: torque ? legs((k, leg) => torque[many * k + 3 * leg + kind]) : [],
    limit: motion.torqueLimit,
    names: legNames,
    resolution: steps.torque,
  }));
  if (!kinds.length) {
    const each = (/** @type {(frame: number, joint: number) => number} */ value) =>
      model.hinges.map((_, joint) => over((frame) => value(frame, joint)));
    const all = torque ? each((k, joint) => torque[many * k + joint]) : [];
    torques.push({
      title: "torque of the joints [N·m]",
      lines: all,
      limit: motion.torqueLimit,
      names: jointNames,
      resolution: steps.torque,
    });
    joints.push({
      title: "joints [rad]",
      lines: each((k, joint) => qpos[k * coordinates + model.hinges[joint]]),
      limit: null,
      names: jointNames,
      resolution: turn,
    });
  }
  const found = [
    {
      title: "margin to the nearest limit",
      lines: motion.margin ? [motion.margin] : [],
      limit: motion.margin ? 0 : null,
      limitNames: motion.limits,
      names: [],
      resolution: steps.margin,
    },
    { title: "force on a foot [N]", lines: legs(pull), limit: null, names: legNames, resolution: steps.force },
    {
      title: "used share of a foot's available friction",
      lines: friction ? legs((k, leg) => friction[model.feet.length * k + leg]) : [],
      limit: 1,
      names: legNames,
      resolution: steps.friction,
    },
    {
      title: "slip of a standing foot [m]",
      lines: footSlips(paths.feet, pull),
      limit: null,
      names: legNames,
      resolution: 2 * place,
    },
    {
      title: "height of a foot [m]",
      lines: paths.feet.map((foot) => over((k) => foot[k][2])),
      limit: null,
      names: legNames,
      resolution: 2 * place,
    },
    ...["x of the base [m]", "y of the base [m]", "height of the base [m]"].map((title, part) => ({
      title,
      lines: free < 0 ? [] : [over((k) => paths.base[k][part])],
      limit: null,
      names: [],
      resolution: place,
    })),
    {
      title: "tilt of the base [°]",
      lines: free < 0 ? [] : [over(tilt)],
      limit: null,
      names: [],
      resolution: (2 * steps.qpos[free + 3] * 180) / Math.PI,
    },
    ...torques,
    ...joints,
  ].map((one) => ({ ...one, group: /** @type {const} */ ("robot") }));
  const policy = motion.signals.map((one) => ({ ...one, limit: null, group: /** @type {const} */ ("policy") }));
  return [...found, ...policy].filter(({ lines }) => lines.length);
}

/**
 * Index of the robot's free joint among the coordinates, -1 without one.
 * @type {(model: Model) => number}
 */
export function freeJointIndex({ bodies, geoms }) {
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
