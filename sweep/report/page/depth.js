// Triangles drawn with a depth buffer, for models with meshes or height fields.
import { rotateVector, addScaled, dot } from "./kinematics.js";
import { geomPose, transpose } from "./solids.js";
import { geomSurface } from "./surface.js";

/** @import { Rgb } from "./dom.js" */
/** @import { Geom, Pose } from "./kinematics.js" */
/** @import { View } from "./scene.js" */

const OVERSAMPLING = 2; // pixels of the buffer for each CSS pixel
const NEAR = 0.05; // m, nearest depth that is drawn

/** @typedef {{ canvas: HTMLCanvasElement, image: ImageData, colours: Uint32Array, depth: Float32Array }} Buffer */
/** @typedef {{ direction: number[], sun: number, scale: number }} Light share of a colour that the sun makes, and brightness */

/** @type {Buffer | null} */
let kept = null;

/** @type {(width: number, height: number) => Buffer} */
function clearedBuffer(width, height) {
  if (kept?.image.width !== width || kept.image.height !== height) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const image = new ImageData(width, height);
    const colours = new Uint32Array(image.data.buffer);
    kept = { canvas, image, colours, depth: new Float32Array(width * height) };
  }
  kept.colours.fill(0);
  kept.depth.fill(0);
  return kept;
}

/**
 * Draw geoms so that near triangles hide far ones.
 * @param {View} view
 * @param {Geom[]} geoms
 * @param {Pose[]} poses of all bodies
 * @param {Light} light
 * @param {Rgb | null} tint instead of their own colours
 */
export function drawSurfaces(view, geoms, poses, light, tint) {
  const { pen, width, height } = view.sheet;
  const [across, down] = [width, height].map((size) => Math.max(1, Math.round(size * OVERSAMPLING)));
  const buffer = clearedBuffer(across, down);
  for (const geom of geoms) drawSurface(view, buffer, geom, poses[geom.body], light, tint ?? geom.colour);
  /** @type {CanvasRenderingContext2D} */ (buffer.canvas.getContext("2d")).putImageData(buffer.image, 0, 0);
  pen.drawImage(buffer.canvas, 0, 0, width, height);
}

/** @type {(view: View, buffer: Buffer, geom: Geom, pose: Pose, light: Light, rgb: Rgb) => void} */
function drawSurface(view, buffer, geom, pose, light, rgb) {
  const { points, triangles, normals, tints } = geomSurface(geom);
  const { pos, turn } = geomPose(geom, pose);
  const inGeom = (/** @type {number[]} */ direction) => rotateVector(transpose(turn), direction);
  const offset = addScaled(pos, view.eye, -1);
  const [eyeX, eyeY, eyeZ] = inGeom(offset).map((part) => -part);
  const [sunX, sunY, sunZ] = inGeom(light.direction);
  const [right, up, away] = view.axes.map(inGeom);
  const [startX, startY, startZ] = view.axes.map((axis) => dot(axis, offset));
  const { width, height } = buffer.image;
  const focus = view.focus * OVERSAMPLING;
  const spots = new Float64Array(points.length); // x and y in pixels, 1 / depth
  for (let k = 0; k < points.length; k += 3) {
    const x = points[k];
    const y = points[k + 1];
    const z = points[k + 2];
    const inverse = 1 / (away[0] * x + away[1] * y + away[2] * z + startZ);
    spots[k] = width / 2 + (right[0] * x + right[1] * y + right[2] * z + startX) * focus * inverse;
    spots[k + 1] = height / 2 - (up[0] * x + up[1] * y + up[2] * z + startY) * focus * inverse;
    spots[k + 2] = inverse;
  }
  const ambient = light.scale * (1 - light.sun / 2);
  const half = (light.scale * light.sun) / 2;
  const lightAt = (/** @type {number} */ at, /** @type {number} */ side) =>
    ambient + side * half * (normals[at] * sunX + normals[at + 1] * sunY + normals[at + 2] * sunZ);
  for (let k = 0; k < tints.length; k++) {
    const p = 3 * triangles[3 * k];
    const q = 3 * triangles[3 * k + 1];
    const r = 3 * triangles[3 * k + 2];
    if (!(spots[p + 2] > 0 && spots[q + 2] > 0 && spots[r + 2] > 0)) continue; // behind the eye
    if (Math.max(spots[p + 2], spots[q + 2], spots[r + 2]) > 1 / NEAR) continue;
    const at = 9 * k;
    const towards =
      normals[at] * (eyeX - points[p]) +
      normals[at + 1] * (eyeY - points[p + 1]) +
      normals[at + 2] * (eyeZ - points[p + 2]);
    const side = towards < 0 ? -1 : 1; // a surface is seen from both sides
    const share = tints[k];
    const first = share * lightAt(at, side);
    const second = share * lightAt(at + 3, side);
    const third = share * lightAt(at + 6, side);
    fillTriangle(buffer, spots, p, q, r, first, second, third, rgb);
  }
}

/**
 * Fill a triangle where nothing nearer is drawn; light and 1 / depth are linear in the picture.
 * @param {Buffer} buffer
 * @param {Float64Array} spots
 * @param {number} p
 * @param {number} q
 * @param {number} r places of its corners
 * @param {number} lightP
 * @param {number} lightQ
 * @param {number} lightR light at the corners, at most 1
 * @param {Rgb} rgb
 */
function fillTriangle(buffer, spots, p, q, r, lightP, lightQ, lightR, rgb) {
  const { colours, depth } = buffer;
  const { width, height } = buffer.image;
  const ax = spots[p];
  const ay = spots[p + 1];
  const bx = spots[q];
  const by = spots[q + 1];
  const cx = spots[r];
  const cy = spots[r + 1];
  const [red, green, blue] = rgb;
  const area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay);
  if (Math.abs(area) < 1e-9) return;
  const top = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5));
  const bottom = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
  // change of the shares of the corners q and r, of 1 / depth, and of light, from pixel to pixel
  const stepQ = (cy - ay) / area;
  const stepR = (ay - by) / area;
  const nearP = spots[p + 2];
  const nearQ = spots[q + 2] - nearP;
  const nearR = spots[r + 2] - nearP;
  const stepNear = stepQ * nearQ + stepR * nearR;
  const stepLight = stepQ * (lightQ - lightP) + stepR * (lightR - lightP);
  for (let row = top; row <= bottom; row++) {
    const y = row + 0.5;
    let left = Infinity; // where edges cross the row
    let right = -Infinity;
    if (ay > y !== by > y) {
      const x = ax + ((y - ay) / (by - ay)) * (bx - ax);
      left = Math.min(left, x);
      right = Math.max(right, x);
    }
    if (by > y !== cy > y) {
      const x = bx + ((y - by) / (cy - by)) * (cx - bx);
      left = Math.min(left, x);
      right = Math.max(right, x);
    }
    if (cy > y !== ay > y) {
      const x = cx + ((y - cy) / (ay - cy)) * (ax - cx);
      left = Math.min(left, x);
      right = Math.max(right, x);
    }
    const first = Math.max(0, Math.ceil(left - 0.5));
    const last = Math.min(width, Math.ceil(right - 0.5));
    const shareQ = ((first + 0.5 - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area;
    const shareR = ((bx - ax) * (y - ay) - (first + 0.5 - ax) * (by - ay)) / area;
    let near = nearP + shareQ * nearQ + shareR * nearR;
    let light = lightP + shareQ * (lightQ - lightP) + shareR * (lightR - lightP);
    for (let at = row * width + first; at < row * width + last; at++) {
      if (near > depth[at]) {
        depth[at] = near;
        colours[at] = 0xff000000 | ((blue * light) << 16) | ((green * light) << 8) | (red * light);
      }
      near += stepNear;
      light += stepLight;
    }
  }
}
