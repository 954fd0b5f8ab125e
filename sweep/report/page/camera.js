// From where a replay is seen: far enough for the whole robot, at an angle that hides it least.
import { endOf, plus, posesOf, stateAt } from "./kinematics.js";
import { clamp } from "./numbers.js";
import { baseOf, obstaclesOf } from "./scene.js";
import { hides, solidOf } from "./solids.js";

/** @import { Model } from "./kinematics.js" */
/** @import { Reel } from "./player.js" */

export const START = { azimuth: -0.75, elevation: 0.36 };
const ANGLES = [-0.75, 0.75, -2.4, 2.4, 0, 3.14]; // that a replay may be seen from at first

/**
 * From how far the robot is seen whole, m.
 * @type {(reel: Reel) => number}
 */
export function farEnough({ model, motion }) {
  const poses = posesOf(model, stateAt(motion, motion.step));
  const base = baseOf(model, poses);
  const parts = model.geoms.filter((geom) => geom.robot).map((geom) => solidOf(geom, poses[geom.body]).pos);
  const reach = Math.max(...parts.map((part) => Math.hypot(...plus(part, base, -1))), 0);
  return clamp(Math.max(8 * sizeOf(model), 3.2 * reach) + 0.15 * Math.abs(base[2]), 1.2, 12);
}

/**
 * The angle that the base is least hidden from, of a few.
 * @type {(reel: Reel) => number}
 */
export function freest(reel) {
  const { model, motion } = reel;
  const solids = Array.from({ length: 9 }, (_, k) => {
    const poses = posesOf(model, stateAt(motion, motion.step + (k / 8) * (endOf(motion) - motion.step)));
    return { base: baseOf(model, poses), solids: obstaclesOf(model, poses) };
  });
  const hidden = ANGLES.map((angle) => {
    const away = [
      Math.cos(angle) * Math.cos(START.elevation),
      Math.sin(angle) * Math.cos(START.elevation),
      Math.sin(START.elevation),
    ];
    return solids.filter(({ base, solids }) =>
      solids.some((one) => hides(one, plus(base, away, farEnough(reel)), base)),
    ).length;
  });
  return ANGLES[hidden.indexOf(Math.min(...hidden))];
}

/**
 * The largest half-size of the robot's parts, m.
 * @type {(model: Model) => number}
 */
export function sizeOf(model) {
  const parts = model.geoms.filter((geom) => geom.robot);
  return parts.reduce((most, geom) => Math.max(most, ...(geom.size ?? (geom.vertices ?? []).flat())), 0);
}
