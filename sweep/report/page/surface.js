// Triangles of a geom's surface with normals, for models with meshes or height fields.
import { addScaled, dot } from "./kinematics.js";

/** @import { Geom } from "./kinematics.js" */

/**
 * @typedef {object} Surface
 * @property {Float64Array} points x, y, z in the geom's axes
 * @property {Int32Array} triangles three points each
 * @property {Float64Array} normals a unit vector for each corner of a triangle
 * @property {Float32Array} tints share of the colour, for each triangle
 */

const SIDES = 20; // of round geoms
const RINGS = 4; // of half a sphere
const CREASE = Math.cos((40 * Math.PI) / 180); // cosine of the angle from which an edge is sharp
const CHECK = 0.95; // share of the colour of every second cell of a height field

/** @type {WeakMap<Geom, Surface>} */
const surfaces = new WeakMap();

/**
 * Surface of a geom; a plane has none.
 * @type {(geom: Geom) => Surface}
 */
export function geomSurface(geom) {
  const known = surfaces.get(geom);
  if (known) return known;
  const { points, faces, tints } = geomTriangles(geom);
  const made = {
    points: Float64Array.from(points.flat()),
    triangles: Int32Array.from(faces.flat()),
    normals: cornerNormals(points, faces),
    tints: Float32Array.from(tints ?? faces.map(() => 1)),
  };
  surfaces.set(geom, made);
  return made;
}

/** @type {(geom: Geom) => { points: number[][], faces: number[][], tints?: number[] }} */
function geomTriangles(geom) {
  const [a = 0, b = 0, c = 0] = geom.size ?? [];
  switch (geom.shape) {
    case "box": {
      const points = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [k & 1 ? a : -a, k & 2 ? b : -b, k & 4 ? c : -c]);
      return {
        points,
        faces: fans(["1375", "0462", "2673", "0154", "4576", "0231"].map((one) => [...one].map(Number))),
      };
    }
    case "sphere":
      return turned(arc(a, 0));
    case "capsule":
      return turned(arc(a, b));
    case "cylinder":
      return turned([[0, -b], [a, -b], [a, b], [0, b]]); // prettier-ignore
    case "mesh":
      return { points: geom.vertices ?? [], faces: fans(geom.faces ?? []) };
    case "field":
      return fieldTriangles(geom);
  }
  return { points: [], faces: [] };
}

/**
 * Split polygons into triangles.
 * @type {(faces: number[][]) => number[][]}
 */
const fans = (faces) => faces.flatMap(([first, ...rest]) => rest.slice(1).map((next, k) => [first, rest[k], next]));

/**
 * Half a circle from below to above, drawn apart by a capsule's half length: radius and height.
 * @type {(radius: number, half: number) => number[][]}
 */
const arc = (radius, half) =>
  [-1, 1].flatMap((side) =>
    Array.from({ length: RINGS + 1 }, (_, k) => {
      const angle = (Math.PI / 2) * (side < 0 ? k / RINGS - 1 : k / RINGS);
      return [radius * Math.max(0, Math.cos(angle)), side * half + radius * Math.sin(angle)];
    }),
  );

/**
 * Turn a line of radii and heights around the z axis.
 * @type {(line: number[][]) => { points: number[][], faces: number[][] }}
 */
function turned(line) {
  const points = line.flatMap(([radius, height]) =>
    Array.from({ length: SIDES }, (_, k) => {
      const angle = (2 * Math.PI * k) / SIDES;
      return [radius * Math.cos(angle), radius * Math.sin(angle), height];
    }),
  );
  const faces = [];
  for (let ring = 0; ring + 1 < line.length; ring++)
    for (let k = 0; k < SIDES; k++) {
      const [p, q] = [ring * SIDES + k, ring * SIDES + ((k + 1) % SIDES)];
      faces.push([p, q, q + SIDES], [p, q + SIDES, p + SIDES]);
    }
  return { points, faces };
}

/** @type {(geom: Geom) => { points: number[][], faces: number[][], tints: number[] }} */
function fieldTriangles({ x = [], y = [], heights = [] }) {
  const points = heights.map((z, k) => [x[k % x.length], y[Math.floor(k / x.length)], z]);
  const faces = [];
  const tints = [];
  for (let j = 0; j + 1 < y.length; j++)
    for (let i = 0; i + 1 < x.length; i++) {
      const k = j * x.length + i;
      faces.push([k, k + 1, k + x.length + 1], [k, k + x.length + 1, k + x.length]);
      const tint = (i + j) % 2 ? CHECK : 1;
      tints.push(tint, tint);
    }
  return { points, faces, tints };
}

/**
 * Normals of corners: the mean of the triangles around a point, up to the next sharp edge.
 * @type {(points: number[][], faces: number[][]) => Float64Array}
 */
function cornerNormals(points, faces) {
  const areas = faces.map(([p, q, r]) =>
    crossProduct(addScaled(points[q], points[p], -1), addScaled(points[r], points[p], -1)),
  );
  const units = areas.map(unit);
  /** @type {number[][]} */
  const around = points.map(() => []);
  faces.forEach((face, k) => face.forEach((point) => around[point].push(k)));
  const found = new Float64Array(9 * faces.length);
  faces.forEach((face, k) =>
    face.forEach((point, corner) => {
      let sum = [0, 0, 0];
      for (const other of around[point]) if (dot(units[k], units[other]) > CREASE) sum = addScaled(sum, areas[other]);
      found.set(unit(sum), 9 * k + 3 * corner);
    }),
  );
  return found;
}

/** @type {(a: number[], b: number[]) => number[]} */
const crossProduct = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @type {(vector: number[]) => number[]} */
function unit(vector) {
  const size = Math.hypot(...vector) || 1;
  return vector.map((part) => part / size);
}
