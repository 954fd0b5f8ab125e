// Convex solids of a scene: faces and mutual occlusion.
import { dot, addScaled, rotateVector, multiplyMatrices, rotationMatrix } from "./kinematics.js";

/** @import { Geom, Pose } from "./kinematics.js" */

/**
 * A geom in the world. A link is drawn as a line with thickness, anything else by its faces.
 * @typedef {object} Solid
 * @property {Geom} geom
 * @property {number[]} pos
 * @property {number[]} turn
 * @property {number[][]} points of its outline, world
 * @property {Face[]} faces
 */

/** @typedef {{ points: number[][], normal: number[], edges: boolean }} Face */

const CYLINDER_SIDES = 36; // polygon sides of a cylinder
const CORNERS = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [k & 1 ? 1 : -1, k & 2 ? 1 : -1, k & 4 ? 1 : -1]);
const BOX = [
  [1, 3, 7, 5],
  [0, 4, 6, 2],
  [2, 6, 7, 3],
  [0, 1, 5, 4],
  [4, 5, 7, 6],
  [0, 2, 3, 1],
];

/**
 * Whether a geom is a limb of the robot: long and round.
 * @type {(geom: Geom) => boolean}
 */
export function isLink(geom) {
  const [radius = 0, half = 0] = geom.size ?? [];
  return geom.robot && (geom.shape === "capsule" || geom.shape === "cylinder") && half > radius;
}

/**
 * Pose of a geom in world axes by the pose of its body.
 * @type {(geom: Geom, pose: Pose) => Pose}
 */
export function geomPose(geom, pose) {
  const pos = addScaled(pose.pos, rotateVector(pose.turn, geom.pos));
  return { pos, turn: multiplyMatrices(pose.turn, rotationMatrix(geom.quat)) };
}

/**
 * Put a geom into world axes by the pose of its body.
 * @type {(geom: Geom, pose: Pose) => Solid}
 */
export function makeSolid(geom, pose) {
  const { pos, turn } = geomPose(geom, pose);
  const world = (/** @type {number[]} */ point) => addScaled(pos, rotateVector(turn, point));
  const faces = isLink(geom) ? [] : geomFaces(geom);
  const placed = faces.map((face) => ({
    points: face.points.map(world),
    normal: rotateVector(turn, face.normal),
    edges: face.edges,
  }));
  return { geom, pos, turn, points: geomOutline(geom).map(world), faces: placed };
}

/**
 * Faces in a geom's own axes.
 * @type {(geom: Geom) => Face[]}
 */
function geomFaces(geom) {
  const [a = 0, b = 0, c = 0] = geom.size ?? [];
  if (geom.shape === "box") {
    const corners = CORNERS.map((s) => [s[0] * a, s[1] * b, s[2] * c]);
    return BOX.map((face, k) => {
      const normal = [0, 0, 0];
      normal[k >> 1] = k % 2 ? -1 : 1;
      return { points: face.map((corner) => corners[corner]), normal, edges: true };
    });
  }
  if (geom.shape === "cylinder" || geom.shape === "capsule") {
    const rim = circlePoints(a);
    const sides = rim.map(([x, y], k) => {
      const [u, v] = rim[(k + 1) % CYLINDER_SIDES];
      return {
        points: [
          [x, y, -b],
          [u, v, -b],
          [u, v, b],
          [x, y, b],
        ],
        normal: [(x + u) / 2 / a, (y + v) / 2 / a, 0],
        edges: false,
      };
    });
    const lids = [1, -1].map((side) => ({
      points: rim.map(([x, y]) => [x, y, side * b]),
      normal: [0, 0, side],
      edges: true,
    }));
    return [...sides, ...lids];
  }
  if (geom.shape === "mesh") {
    const vertices = geom.vertices ?? [];
    return (geom.faces ?? []).map((face) => {
      const points = face.map((k) => vertices[k]);
      return { points, normal: faceNormal(points), edges: true };
    });
  }
  return [];
}

/** @type {(radius: number) => number[][]} */
const circlePoints = (radius) =>
  Array.from({ length: CYLINDER_SIDES }, (_, k) => {
    const angle = (2 * Math.PI * k) / CYLINDER_SIDES;
    return [radius * Math.cos(angle), radius * Math.sin(angle)];
  });

/**
 * Unit normal of a face whose points are counterclockwise from outside.
 * @type {(points: number[][]) => number[]}
 */
function faceNormal(points) {
  const [p, q, r] = points;
  const [a, b] = [addScaled(q, p, -1), addScaled(r, p, -1)];
  const cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const size = Math.hypot(...cross) || 1;
  return cross.map((part) => part / size);
}

/**
 * Points at the ends of a geom, in its own axes.
 * @type {(geom: Geom) => number[][]}
 */
function geomOutline(geom) {
  const [a = 0, b = 0, c = 0] = geom.size ?? [];
  switch (geom.shape) {
    case "box":
      return CORNERS.map((s) => [s[0] * a, s[1] * b, s[2] * c]);
    case "mesh":
      return geom.vertices ?? [];
    case "sphere":
      return [
        [0, 0, a],
        [0, 0, -a],
        [a, 0, 0],
        [-a, 0, 0],
        [0, a, 0],
        [0, -a, 0],
        [0, 0, 0],
      ];
    case "plane":
      return [[0, 0, 0]];
  }
  if (isLink(geom))
    return [
      [0, 0, -b],
      [0, 0, b],
    ];
  return [-b, 0, b].flatMap((z) =>
    circlePoints(a)
      .filter((_, k) => k % 4 === 0)
      .map(([x, y]) => [x, y, z]),
  );
}

/**
 * Whether a solid stands between the eye and a point.
 * @type {(solid: Solid, eye: number[], point: number[]) => boolean}
 */
export function hides(solid, eye, point) {
  const local = (/** @type {number[]} */ p) => rotateVector(transpose(solid.turn), addScaled(p, solid.pos, -1));
  const [from, to] = [local(eye), local(point)];
  const way = addScaled(to, from, -1);
  const [a = 0, b = 0, c = 0] = solid.geom.size ?? [];
  /** @type {[number, number]} */
  let part = [0, 1 - 1e-6];
  const cut = (/** @type {number} */ at, /** @type {number} */ along) => {
    // part of the ray where at + share * along < 0
    if (along > 0) part = [part[0], Math.min(part[1], -at / along)];
    else if (along < 0) part = [Math.max(part[0], -at / along), part[1]];
    else if (at >= 0) part = [1, 0];
  };
  switch (solid.geom.shape) {
    case "box":
      [a, b, c].forEach((half, k) => [1, -1].forEach((side) => cut(side * from[k] - half, side * way[k])));
      break;
    case "sphere":
      round(from, way, a, 3);
      break;
    case "cylinder":
    case "capsule":
      [1, -1].forEach((side) => cut(side * from[2] - b, side * way[2]));
      round(from, way, a, 2);
      break;
    case "mesh":
      for (const face of geomFaces(solid.geom)) {
        const [p] = face.points;
        cut(dot(addScaled(from, p, -1), face.normal), dot(way, face.normal));
      }
      break;
    default:
      return false;
  }
  return part[1] - part[0] > 1e-4;

  /**
   * @param {number[]} start
   * @param {number[]} along
   * @param {number} radius
   * @param {number} axes number of axes to use
   */
  function round(start, along, radius, axes) {
    let [square, middle, rest] = [0, 0, -radius * radius];
    for (let k = 0; k < axes; k++) {
      square += along[k] ** 2;
      middle += along[k] * start[k];
      rest += start[k] ** 2;
    }
    const root = middle ** 2 - square * rest;
    if (square < 1e-12) {
      if (rest >= 0) part = [1, 0];
    } else if (root <= 0) part = [1, 0];
    else
      part = [
        Math.max(part[0], (-middle - Math.sqrt(root)) / square),
        Math.min(part[1], (-middle + Math.sqrt(root)) / square),
      ];
  }
}

/** @type {(turn: number[]) => number[]} */
export function transpose(turn) {
  return [turn[0], turn[3], turn[6], turn[1], turn[4], turn[7], turn[2], turn[5], turn[8]];
}

/**
 * Sort solids from back to front.
 * @type {(solids: Solid[], eye: number[]) => Solid[]}
 */
export function sortBackToFront(solids, eye) {
  const middles = solids.map((solid) => {
    const sum = solid.points.reduce((a, b) => addScaled(a, b), [0, 0, 0]);
    return sum.map((part) => part / solid.points.length);
  });
  const covers = solids.map((front, i) =>
    solids.map((behind, j) => {
      if (i === j) return false;
      // points a little inside, since solids may touch
      return behind.points.some((point) =>
        hides(front, eye, addScaled(middles[j], addScaled(point, middles[j], -1), 0.98)),
      );
    }),
  );
  const left = solids.map((_, k) => k);
  const away = (/** @type {number} */ k) => Math.hypot(...addScaled(middles[k], eye, -1));
  const order = [];
  while (left.length) {
    const free = left.filter((j) => !left.some((i) => covers[j][i]));
    const next = (free.length ? free : left).reduce((a, b) => (away(b) > away(a) ? b : a));
    left.splice(left.indexOf(next), 1);
    order.push(solids[next]);
  }
  return order;
}
