// Initial camera of a replay: far enough to show the whole robot, at the angle that hides it least.
import { endTime, addScaled, bodyPoses, stateAt } from "./kinematics.js";
import { clamp } from "./numbers.js";
import { basePosition, obstacleSolids } from "./scene.js";
import { hides, makeSolid } from "./solids.js";

/** @import { Geom, Model } from "./kinematics.js" */
/** @import { Reel } from "./player.js" */

export const START_VIEW = { azimuth: -0.75, elevation: 0.36 };
const START_ANGLES = [-0.75, 0.75, -2.4, 2.4, 0, 3.14]; // azimuths to choose the first view from, rad

/**
 * Distance from which the whole robot is visible, m.
 * @type {(reel: Reel) => number}
 */
export function viewingDistance({ model, motion }) {
  const poses = bodyPoses(model, stateAt(motion, motion.step));
  const base = basePosition(model, poses);
  const parts = model.geoms.filter((geom) => geom.robot).map((geom) => makeSolid(geom, poses[geom.body]).pos);
  const reach = Math.max(...parts.map((part) => Math.hypot(...addScaled(part, base, -1))), 0);
  return clamp(Math.max(8 * robotSize(model), 3.2 * reach) + 0.15 * Math.abs(base[2]), 1.2, 12);
}

/**
 * Choose the azimuth at which obstacles hide the base least.
 * @type {(reel: Reel) => number}
 */
export function leastHiddenAngle(reel) {
  const { model, motion } = reel;
  const solids = Array.from({ length: 9 }, (_, k) => {
    const poses = bodyPoses(model, stateAt(motion, motion.step + (k / 8) * (endTime(motion) - motion.step)));
    return { base: basePosition(model, poses), solids: obstacleSolids(model, poses) };
  });
  const hidden = START_ANGLES.map((angle) => {
    const away = [
      Math.cos(angle) * Math.cos(START_VIEW.elevation),
      Math.sin(angle) * Math.cos(START_VIEW.elevation),
      Math.sin(START_VIEW.elevation),
    ];
    return solids.filter(({ base, solids }) =>
      solids.some((one) => hides(one, addScaled(base, away, viewingDistance(reel)), base)),
    ).length;
  });
  return START_ANGLES[hidden.indexOf(Math.min(...hidden))];
}

/**
 * The largest half-size of the robot's parts, m.
 * @type {(model: Model) => number}
 */
export function robotSize(model) {
  const parts = model.geoms.filter((geom) => geom.robot);
  const sizes = (/** @type {Geom} */ { size, vertices = [] }) => size ?? vertices.flat();
  return parts.reduce((most, geom) => sizes(geom).reduce((a, b) => Math.max(a, b), most), 0);
}
