// 3D drawing of robot and obstacle on a canvas, by polygons and thick lines from back to front.
import { cssColour, drawLine } from "./dom.js";
import { dot, addScaled, rotateVector } from "./kinematics.js";
import { clamp, formatShort, mixColours } from "./numbers.js";
import { drawSurfaces } from "./depth.js";
import { sortBackToFront, geomPose, hides, isLink, makeSolid } from "./solids.js";
import { geomSurface } from "./surface.js";

/** @import { Rgb, Sheet, Theme } from "./dom.js" */
/** @import { Geom, Model, Pose, Push } from "./kinematics.js" */
/** @import { Light } from "./depth.js" */
/** @import { Solid } from "./solids.js" */

/** @typedef {{ azimuth: number, elevation: number, distance: number, target: number[] }} Camera angles in rad */

/**
 * @typedef {object} View
 * @property {Sheet} sheet
 * @property {Theme} theme
 * @property {number[]} eye
 * @property {number[][]} axes right, up, and away from the eye
 * @property {number} focus pixels
 */

/** @typedef {{ x: number, y: number, depth: number }} Spot */

const NEAR_PLANE = 0.05; // m, distance of the near clipping plane
const LIGHT = [0.36, -0.48, 0.8]; // direction towards the light
const LINK_PIECES = 6; // pieces of a link, each sorted by depth on its own
const GRID_STEP = 0.5; // m
const SHADOW_POINTS = 60; // points of a surface that its shadow is drawn by
const GROUND_RADIUS = 12; // m of ground drawn around the target
const SUN_SHARE = 0.55; // share of a face's colour that depends on the light
const PUSH_SHOWN = 0.15; // s before and after a push that its arrow is shown
const GRID_LINES = gridLines(4);

/**
 * Lines of the ground's grid around the origin, from the strongest to the faintest: offset, start and end of each, m.
 * @type {(levels: number) => [number, number, number][][]}
 */
function gridLines(levels) {
  /** @type {[number, number, number][][]} */
  const found = Array.from({ length: levels }, () => []);
  const levelOf = (/** @type {number} */ k, /** @type {number} */ j) =>
    Math.floor((6 * Math.hypot(k, j + GRID_STEP)) / GROUND_RADIUS);
  for (let k = -GROUND_RADIUS; k <= GROUND_RADIUS; k += GRID_STEP)
    for (let j = -GROUND_RADIUS, from = j; j < GROUND_RADIUS; j += 2 * GRID_STEP) {
      const [level, next] = [levelOf(k, j), j + 2 * GRID_STEP];
      if (next < GROUND_RADIUS && levelOf(k, next) === level) continue;
      found[level]?.push([k, from, next]);
      from = next;
    }
  return found;
}

/** @type {(sheet: Sheet, theme: Theme, camera: Camera) => View} */
export function makeView(sheet, theme, camera) {
  const { azimuth, elevation, distance, target } = camera;
  const [ca, sa] = [Math.cos(azimuth), Math.sin(azimuth)];
  const [ce, se] = [Math.cos(elevation), Math.sin(elevation)];
  const away = [-ca * ce, -sa * ce, -se];
  const axes = [[-sa, ca, 0], [-ca * se, -sa * se, ce], away];
  const focus = 1.25 * Math.min(sheet.width * 1.1, sheet.height * 1.35);
  return { sheet, theme, eye: addScaled(target, away, -distance), axes, focus };
}

/**
 * Coordinates of a point in camera axes: right, up, and away from the eye.
 * @type {(view: View, point: ArrayLike<number>) => number[]}
 */
function toCameraAxes(view, point) {
  const offset = addScaled(point, view.eye, -1);
  return view.axes.map((axis) => dot(axis, offset));
}

/** @type {(view: View, local: number[]) => Spot} */
function project(view, local) {
  const { width, height } = view.sheet;
  const scale = view.focus / local[2];
  return { x: width / 2 + local[0] * scale, y: height / 2 - local[1] * scale, depth: local[2] };
}

/**
 * Clip a polygon at the near plane and project it.
 * @type {(view: View, points: number[][]) => Spot[]}
 */
export function clipPolygon(view, points) {
  const locals = points.map((point) => toCameraAxes(view, point));
  const kept = [];
  for (let k = 0; k < locals.length; k++) {
    const [a, b] = [locals[k], locals[(k + 1) % locals.length]];
    if (a[2] >= NEAR_PLANE) kept.push(a);
    if (a[2] >= NEAR_PLANE !== b[2] >= NEAR_PLANE)
      kept.push(addScaled(a, addScaled(b, a, -1), (NEAR_PLANE - a[2]) / (b[2] - a[2])));
  }
  return kept.map((local) => project(view, local));
}

/** @type {(view: View, points: number[][], fill: string | null, stroke: string | null) => void} */
function drawPolygon(view, points, fill, stroke) {
  const spots = clipPolygon(view, points);
  if (spots.length < 3) return;
  const { pen } = view.sheet;
  pen.beginPath();
  spots.forEach(({ x, y }, k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.closePath();
  if (fill) {
    pen.fillStyle = fill;
    pen.fill();
  }
  if (stroke) {
    pen.strokeStyle = stroke;
    pen.stroke();
  }
}

/**
 * Shade a colour by the direction of a normal to the light.
 * @type {(theme: Theme, rgb: Rgb, normal: number[]) => Rgb}
 */
function shade(theme, rgb, normal) {
  const share = 1 - SUN_SHARE / 2 + (SUN_SHARE / 2) * dot(normal, LIGHT);
  return mixColours([0, 0, 0], rgb, clamp(share * (theme.dark ? 0.8 : 1.04), 0, 1));
}

/** @type {(theme: Theme) => Light} */
const lightOf = (theme) => ({ direction: LIGHT, sun: SUN_SHARE, scale: theme.dark ? 0.8 : 1 });

/**
 * Whether a model has surfaces that are not convex, which need a depth buffer.
 * @type {(model: Model) => boolean}
 */
export function hasSurfaces({ geoms }) {
  return geoms.some(({ shape, mesh }) => shape === "field" || mesh !== undefined);
}

/**
 * Draw sky, ground, obstacles and robot.
 * @param {View} view
 * @param {Model} model
 * @param {Pose[]} poses of its bodies
 * @param {number[]} target around which the ground fades
 */
export function drawWorld(view, model, poses, target) {
  drawSky(view);
  if (hasSurfaces(model)) {
    const rest = model.geoms.filter(({ shape }) => shape !== "plane");
    for (const geom of model.geoms) {
      if (geom.shape !== "plane") continue;
      const ground = makeSolid(geom, poses[geom.body]);
      drawGround(view, ground, target);
      drawSurfaceShadow(view, ground, rest, poses);
    }
    drawSurfaces(view, rest, poses, lightOf(view.theme), null);
    return;
  }
  const solids = model.geoms.map((geom) => makeSolid(geom, poses[geom.body]));
  const grounds = solids.filter((solid) => solid.geom.shape === "plane");
  for (const ground of grounds) drawGround(view, ground, target);
  const bodies = solids.filter((solid) => solid.geom.shape !== "plane" && !isLink(solid.geom));
  const links = solids.filter((solid) => isLink(solid.geom));
  for (const ground of grounds) drawShadows(view, ground, [...links, ...bodies.filter((b) => b.geom.robot)]);
  drawInOrder(view, bodies, links, null);
}

/**
 * Draw the robot alone in one colour.
 * @type {(view: View, model: Model, poses: Pose[], tint: Rgb) => void}
 */
export function drawRobot(view, model, poses, tint) {
  if (hasSurfaces(model)) {
    const robot = model.geoms.filter((geom) => geom.robot);
    drawSurfaces(view, robot, poses, lightOf(view.theme), tint);
    return;
  }
  const solids = model.geoms.map((geom) => makeSolid(geom, poses[geom.body]));
  const links = solids.filter((solid) => isLink(solid.geom));
  const bodies = solids.filter((solid) => solid.geom.robot && !isLink(solid.geom));
  drawInOrder(view, bodies, links, tint);
}

/** @type {(view: View, bodies: Solid[], links: Solid[], tint: Rgb | null) => void} */
function drawInOrder(view, bodies, links, tint) {
  const order = sortBackToFront(bodies, view.eye);
  const layers = /** @type {{ depth: number, draw: () => void }[][]} */ ([...order, null].map(() => []));
  for (const link of links) {
    const [a, b] = link.points;
    const radius = link.geom.size?.[0] ?? 0.01;
    const along = addScaled(b, a, -1);
    const places = Array.from({ length: LINK_PIECES }, (_, k) =>
      layerOf(addScaled(a, along, (k + 0.5) / LINK_PIECES), radius),
    );
    for (let k = 0, from = 0; k < LINK_PIECES; k++) {
      if (k + 1 < LINK_PIECES && places[k + 1] === places[k]) continue;
      const [start, end] = [addScaled(a, along, from / LINK_PIECES), addScaled(a, along, (k + 1) / LINK_PIECES)];
      const depth = (toCameraAxes(view, start)[2] + toCameraAxes(view, end)[2]) / 2;
      layers[places[k]].push({ depth, draw: () => drawLink(view, start, end, radius, tint ?? link.geom.colour) });
      from = k + 1;
    }
  }
  layers.forEach((layer, k) => {
    layer.sort((a, b) => b.depth - a.depth).forEach((piece) => piece.draw());
    if (k < order.length) drawSolid(view, order[k], tint);
  });

  /**
   * Index of the first sorted body that hides a piece; the piece is drawn before it.
   * @type {(point: number[], radius: number) => number}
   */
  function layerOf(point, radius) {
    const towards = addScaled(view.eye, point, -1);
    const before = addScaled(point, towards, (1.5 * radius) / Math.hypot(...towards)); // a touching body does not hide it
    const first = order.findIndex((body) => hides(body, view.eye, before));
    return first < 0 ? order.length : first;
  }
}

/** @param {View} view */
function drawSky({ sheet, theme }) {
  const { pen, width, height } = sheet;
  const sky = pen.createLinearGradient(0, 0, 0, height);
  const [high, low] = theme.dark ? ["#20252d", "#161a20"] : ["#dfe8f0", "#f7f9fb"];
  sky.addColorStop(0, high);
  sky.addColorStop(0.75, low);
  pen.fillStyle = sky;
  pen.fillRect(0, 0, width, height);
}

/**
 * Draw a ground plane with a grid, fading out around the target.
 * @type {(view: View, ground: Solid, target: number[]) => void}
 */
function drawGround(view, ground, target) {
  const { pen } = view.sheet;
  const [right, ahead, normal] = [0, 1, 2].map((k) => [ground.turn[k], ground.turn[3 + k], ground.turn[6 + k]]);
  const [u, v] = [right, ahead].map((axis) => dot(axis, addScaled(target, ground.pos, -1)));
  const at = (/** @type {number} */ x, /** @type {number} */ y) => addScaled(addScaled(ground.pos, right, x), ahead, y);
  const below = dot(addScaled(view.eye, ground.pos, -1), normal) < 0;
  const soil = cssColour(view.theme.dark ? [46, 52, 55] : [226, 230, 225], below ? 0.15 : 0.34);
  const ring = (/** @type {number} */ radius) =>
    Array.from({ length: 40 }, (_, k) => at(u + radius * Math.cos(k / 6.3662), v + radius * Math.sin(k / 6.3662)));
  for (let k = 0; k < 8; k++) drawPolygon(view, ring(GROUND_RADIUS * (1 - k / 10)), soil, null);
  const ink = view.theme.dark ? [120, 132, 140] : [120, 132, 126];
  pen.lineWidth = 1;
  const [x, y] = [u, v].map((value) => Math.round(value / GRID_STEP) * GRID_STEP);
  GRID_LINES.forEach((lines, level) => {
    pen.strokeStyle = cssColour(/** @type {Rgb} */ (ink), (0.34 * (GRID_LINES.length - level)) / GRID_LINES.length);
    pen.beginPath();
    for (const [k, from, to] of lines)
      for (const [p, q] of [
        [at(x + k, y + from), at(x + k, y + to)],
        [at(x + from, y + k), at(x + to, y + k)],
      ]) {
        const [a, b] = clipPolygon(view, [p, q, q]);
        if (!b) continue;
        pen.moveTo(a.x, a.y);
        pen.lineTo(b.x, b.y);
      }
    pen.stroke();
  });
}

/**
 * Draw soft shadows on a plane, cast along its normal.
 * @type {(view: View, ground: Solid, casting: Solid[]) => void}
 */
function drawShadows(view, ground, casting) {
  const normal = [ground.turn[2], ground.turn[5], ground.turn[8]];
  const { pen } = view.sheet;
  const fallen = (/** @type {number[]} */ point) => {
    const height = dot(addScaled(point, ground.pos, -1), normal);
    return { spot: addScaled(point, normal, -height), height };
  };
  pen.lineCap = "round";
  for (const solid of casting) {
    const spots = solid.points.map(fallen);
    const height = spots.reduce((sum, { height }) => sum + height, 0) / spots.length;
    const opacity = (view.theme.dark ? 0.4 : 0.16) / (1 + Math.max(0, height));
    if (isLink(solid.geom)) {
      const [a, b] = clipPolygon(view, [spots[0].spot, spots[1].spot, spots[1].spot]);
      if (!b) continue;
      pen.strokeStyle = cssColour([0, 0, 0], opacity);
      pen.lineWidth = ((2.4 * (solid.geom.size?.[0] ?? 0.01)) / ((a.depth + b.depth) / 2)) * view.focus;
      drawLine(pen, a.x, a.y, b.x, b.y);
    } else if (solid.geom.shape === "box") {
      const shadow = cssColour([0, 0, 0], opacity / 2);
      for (const { points } of solid.faces.slice(4)) {
        const below = points.map((point) => fallen(point).spot);
        drawPolygon(view, below, shadow, null);
      }
    }
  }
}

/**
 * Draw the shadow of all geoms of the robot on a plane, cast along its normal.
 * @type {(view: View, ground: Solid, geoms: Geom[], poses: Pose[]) => void}
 */
function drawSurfaceShadow(view, ground, geoms, poses) {
  const { pen } = view.sheet;
  const [right, ahead] = [0, 1].map((k) => [ground.turn[k], ground.turn[3 + k], ground.turn[6 + k]]);
  pen.beginPath();
  for (const geom of geoms) {
    if (!geom.robot) continue;
    const { pos, turn } = geomPose(geom, poses[geom.body]);
    const { points } = geomSurface(geom);
    const every = Math.max(1, Math.floor(points.length / 3 / SHADOW_POINTS));
    /** @type {[number, number][]} */
    const fallen = [];
    for (let k = 0; k < points.length; k += 3 * every) {
      const offset = addScaled(addScaled(pos, rotateVector(turn, points.subarray(k, k + 3))), ground.pos, -1);
      fallen.push([dot(offset, right), dot(offset, ahead)]);
    }
    const rim = planarHull(fallen).map(([x, y]) => addScaled(addScaled(ground.pos, right, x), ahead, y));
    clipPolygon(view, rim).forEach(({ x, y }, k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
  }
  pen.fillStyle = cssColour([0, 0, 0], view.theme.dark ? 0.4 : 0.16);
  pen.fill();
}

/**
 * Convex hull of points in a plane, counterclockwise.
 * @type {(points: [number, number][]) => [number, number][]}
 */
function planarHull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (/** @type {[number, number][]} */ line) => {
    /** @type {[number, number][]} */
    const rim = [];
    for (const [x, y] of line) {
      for (let k = rim.length; k > 1; k = rim.length) {
        const [[a, b], [c, d]] = [rim[k - 2], rim[k - 1]];
        if ((c - a) * (y - b) - (d - b) * (x - a) > 0) break;
        rim.pop();
      }
      rim.push([x, y]);
    }
    return rim.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** @type {(view: View, solid: Solid, tint: Rgb | null) => void} */
function drawSolid(view, solid, tint) {
  const own = tint ?? solid.geom.colour;
  if (solid.geom.shape === "sphere") {
    drawBall(view, solid, own);
    return;
  }
  const { pen } = view.sheet;
  pen.lineWidth = 1;
  for (const face of solid.faces) {
    if (dot(addScaled(face.points[0], view.eye, -1), face.normal) >= 0) continue;
    const colour = shade(view.theme, own, face.normal);
    const edge = face.edges
      ? cssColour(mixColours(colour, view.theme.dark ? [0, 0, 0] : [255, 255, 255], 0.35))
      : cssColour(colour);
    drawPolygon(view, face.points, cssColour(colour), edge);
  }
}

/**
 * Draw a ball with three circles that show its rotation.
 * @type {(view: View, solid: Solid, own: Rgb) => void}
 */
function drawBall(view, solid, own) {
  const { pen } = view.sheet;
  const local = toCameraAxes(view, solid.pos);
  if (local[2] < NEAR_PLANE) return;
  const radius = solid.geom.size?.[0] ?? 0;
  const { x, y, depth } = project(view, local);
  const size = (radius / Math.sqrt(Math.max(depth ** 2 - radius ** 2, 1e-6))) * view.focus;
  const light = pen.createRadialGradient(x + 0.25 * size, y - 0.4 * size, 0.1 * size, x, y, 1.1 * size);
  light.addColorStop(0, cssColour(mixColours(own, [255, 255, 255], view.theme.dark ? 0.1 : 0.45)));
  light.addColorStop(1, cssColour(mixColours(own, [0, 0, 0], 0.35)));
  pen.fillStyle = light;
  pen.beginPath();
  pen.arc(x, y, size, 0, 2 * Math.PI);
  pen.fill();
  pen.strokeStyle = cssColour(mixColours(own, [0, 0, 0], 0.45), 0.6);
  pen.lineWidth = 1;
  for (let circle = 0; circle < 3; circle++) {
    let before = /** @type {Spot | null} */ (null);
    pen.beginPath();
    for (let k = 0; k <= 48; k++) {
      const angle = (2 * Math.PI * k) / 48;
      const point = [0, 0, 0];
      point[circle] = radius * Math.cos(angle);
      point[(circle + 1) % 3] = radius * Math.sin(angle);
      const out = rotateVector(solid.turn, point);
      const place = addScaled(solid.pos, out);
      const facing = dot(addScaled(view.eye, place, -1), out) > 0;
      const spot = facing ? project(view, toCameraAxes(view, place)) : null;
      if (spot && before) pen.lineTo(spot.x, spot.y);
      else if (spot) pen.moveTo(spot.x, spot.y);
      before = spot;
    }
    pen.stroke();
  }
}

/**
 * Draw a limb: a thick line that tapers with distance, brighter towards the light.
 * @type {(view: View, from: number[], to: number[], radius: number, rgb: Rgb) => void}
 */
function drawLink(view, from, to, radius, rgb) {
  const [a, b] = [toCameraAxes(view, from), toCameraAxes(view, to)];
  if (a[2] < NEAR_PLANE || b[2] < NEAR_PLANE) return;
  const { pen } = view.sheet;
  const [p, q] = [project(view, a), project(view, b)];
  const [r, s] = [Math.max((radius / a[2]) * view.focus, 1), Math.max((radius / b[2]) * view.focus, 1)];
  const colour = mixColours([0, 0, 0], rgb, view.theme.dark ? 0.88 : 0.94);
  limb(p, q, r + 0.9, s + 0.9, cssColour(mixColours(colour, [0, 0, 0], 0.45)));
  limb(p, q, r, s, cssColour(colour));
  const moved = (/** @type {Spot} */ { x, y, depth }, /** @type {number} */ size) => ({
    x: x - 0.3 * size,
    y: y - 0.34 * size,
    depth,
  });
  limb(moved(p, r), moved(q, s), 0.42 * r, 0.42 * s, cssColour(mixColours(colour, [255, 255, 255], 0.36)));

  /**
   * @param {Spot} start
   * @param {Spot} end
   * @param {number} first
   * @param {number} last radii
   * @param {string} fill
   */
  function limb(start, end, first, last, fill) {
    const angle = Math.atan2(end.y - start.y, end.x - start.x);
    pen.fillStyle = fill;
    pen.beginPath();
    pen.arc(start.x, start.y, first, angle + Math.PI / 2, angle - Math.PI / 2);
    pen.arc(end.x, end.y, last, angle - Math.PI / 2, angle + Math.PI / 2);
    pen.closePath();
    pen.fill();
  }
}

/**
 * Draw forces on the feet as arrows.
 * @param {View} view
 * @param {Model} model
 * @param {Pose[]} poses of its bodies
 * @param {Float64Array} force (18,) N
 * @param {{ metres: number, least: number }} arrow m per N, and the smallest force with an arrow
 */
export function drawForces(view, model, poses, force, arrow) {
  const colour = view.theme.dark ? "#ffc24d" : "#e08e00";
  model.feet.forEach(([body, ...place], foot) => {
    const pull = force.subarray(3 * foot, 3 * foot + 3);
    if (Math.hypot(...pull) <= arrow.least) return;
    const tail = addScaled(poses[body].pos, rotateVector(poses[body].turn, place));
    drawArrow(view, tail, addScaled(tail, pull, arrow.metres), colour, 2.6);
  });
}

/**
 * Draw the pushes of a time as arrows that end at the centre of mass of the pushed body, with their size.
 * @type {(view: View, pushes: Push[], poses: Pose[], time: number, longest: number) => void} `longest` arrow in m
 */
export function drawPushes(view, pushes, poses, time, longest) {
  const most = Math.max(...pushes.map(({ force }) => Math.hypot(...force)));
  const colour = view.theme.dark ? "#ff7ab0" : "#b3135f";
  for (const { body, point, force, start, end } of pushes) {
    if (time < start - PUSH_SHOWN || time > end + PUSH_SHOWN) continue;
    const pose = poses[body];
    const tip = addScaled(pose.pos, rotateVector(pose.turn, point));
    const tail = addScaled(tip, force, -longest / most);
    drawArrow(view, tail, tip, colour, 4);
    const locals = [tail, tip].map((place) => toCameraAxes(view, place));
    if (locals.some((local) => local[2] < NEAR_PLANE)) continue;
    const { pen } = view.sheet;
    const [from, to] = locals.map((local) => project(view, local));
    const [x, y] = [from.x, from.y + (to.y > from.y ? -8 : 24)];
    const size = `push ${formatShort(Number(Math.hypot(...force).toPrecision(3)))} N, ${formatShort(end - start)} s`;
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    pen.lineWidth = 3;
    pen.strokeStyle = cssColour(view.theme.paper, 0.85);
    pen.fillStyle = colour;
    pen.strokeText(size, x, y);
    pen.fillText(size, x, y);
  }
}

/** @type {(view: View, tail: number[], end: number[], colour: string, width: number) => void} */
function drawArrow(view, tail, end, colour, width) {
  const { pen } = view.sheet;
  const [a, b] = [toCameraAxes(view, tail), toCameraAxes(view, end)];
  if (a[2] < NEAR_PLANE || b[2] < NEAR_PLANE) return;
  const [p, q] = [project(view, a), project(view, b)];
  const length = Math.hypot(q.x - p.x, q.y - p.y);
  const head = Math.min(3.5 * width, length / 2);
  const angle = Math.atan2(q.y - p.y, q.x - p.x);
  const tip = (/** @type {number} */ back, /** @type {number} */ aside) =>
    /** @type {const} */ ([
      q.x - back * Math.cos(angle) - aside * Math.sin(angle),
      q.y - back * Math.sin(angle) + aside * Math.cos(angle),
    ]);
  pen.lineCap = "round";
  for (const [stroke, wide] of /** @type {[string, number][]} */ ([
    [cssColour(view.theme.paper, 0.8), width + 2.4],
    [colour, width],
  ])) {
    pen.strokeStyle = pen.fillStyle = stroke;
    pen.lineWidth = wide;
    drawLine(pen, p.x, p.y, ...tip(head, 0));
    pen.beginPath();
    pen.moveTo(q.x, q.y);
    pen.lineTo(...tip(head, head / 2));
    pen.lineTo(...tip(head, -head / 2));
    pen.closePath();
    pen.fill();
    if (wide > width) pen.stroke();
  }
}

/**
 * Solids of the obstacle, which may hide the robot.
 * @type {(model: Model, poses: Pose[]) => Solid[]}
 */
export function obstacleSolids(model, poses) {
  const others = model.geoms.filter((geom) => !geom.robot && geom.shape !== "plane" && geom.shape !== "field");
  return others.map((geom) => makeSolid(geom, poses[geom.body]));
}

/**
 * Position of the robot's base.
 * @type {(model: Model, poses: Pose[]) => number[]}
 */
export function basePosition(model, poses) {
  const robot = model.geoms.find((geom) => geom.robot);
  return robot ? poses[robot.body].pos : [0, 0, 0];
}
