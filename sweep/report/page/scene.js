// The robot on its obstacle, drawn on a canvas: no more than polygons, thick lines and their order.
import { cssOf, straight } from "./dom.js";
import { dot, plus, rotated } from "./kinematics.js";
import { clamp, mixed } from "./numbers.js";
import { backToFront, hides, isLink, solidOf } from "./solids.js";

/** @import { Rgb, Sheet, Theme } from "./dom.js" */
/** @import { Model, Pose } from "./kinematics.js" */
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

const NEAR = 0.05; // m before the eye, from where things are seen
const LIGHT = [0.36, -0.48, 0.8]; // towards the light
const PIECES = 6; // of a link, each behind or before what it passes
const GRID = 0.5; // m
const REACH = 12; // m of ground that is seen around the target
const SUN = 0.55; // share of a face's colour that depends on the light
const GRID_LINES = linesOf(4);

/**
 * The grid's lines (m) around the origin, from the strongest to the faintest: each how far aside it is, from where to
 * where.
 * @type {(levels: number) => [number, number, number][][]}
 */
function linesOf(levels) {
  /** @type {[number, number, number][][]} */
  const found = Array.from({ length: levels }, () => []);
  const levelOf = (/** @type {number} */ k, /** @type {number} */ j) =>
    Math.floor((6 * Math.hypot(k, j + GRID)) / REACH);
  for (let k = -REACH; k <= REACH; k += GRID)
    for (let j = -REACH, from = j; j < REACH; j += 2 * GRID) {
      const [level, next] = [levelOf(k, j), j + 2 * GRID];
      if (next < REACH && levelOf(k, next) === level) continue;
      found[level]?.push([k, from, next]);
      from = next;
    }
  return found;
}

/** @type {(sheet: Sheet, theme: Theme, camera: Camera) => View} */
export function viewOf(sheet, theme, camera) {
  const { azimuth, elevation, distance, target } = camera;
  const [ca, sa] = [Math.cos(azimuth), Math.sin(azimuth)];
  const [ce, se] = [Math.cos(elevation), Math.sin(elevation)];
  const away = [-ca * ce, -sa * ce, -se];
  const axes = [[-sa, ca, 0], [-ca * se, -sa * se, ce], away];
  const focus = 1.25 * Math.min(sheet.width * 1.1, sheet.height * 1.35);
  return { sheet, theme, eye: plus(target, away, -distance), axes, focus };
}

/**
 * How far a point is to the right of the eye, up and away.
 * @type {(view: View, point: ArrayLike<number>) => number[]}
 */
function seen(view, point) {
  const offset = plus(point, view.eye, -1);
  return view.axes.map((axis) => dot(axis, offset));
}

/** @type {(view: View, local: number[]) => Spot} */
function onSheet(view, local) {
  const { width, height } = view.sheet;
  const scale = view.focus / local[2];
  return { x: width / 2 + local[0] * scale, y: height / 2 - local[1] * scale, depth: local[2] };
}

/**
 * The part of a polygon that is before the eye, on the sheet.
 * @type {(view: View, points: number[][]) => Spot[]}
 */
export function outline(view, points) {
  const locals = points.map((point) => seen(view, point));
  const kept = [];
  for (let k = 0; k < locals.length; k++) {
    const [a, b] = [locals[k], locals[(k + 1) % locals.length]];
    if (a[2] >= NEAR) kept.push(a);
    if (a[2] >= NEAR !== b[2] >= NEAR) kept.push(plus(a, plus(b, a, -1), (NEAR - a[2]) / (b[2] - a[2])));
  }
  return kept.map((local) => onSheet(view, local));
}

/** @type {(view: View, points: number[][], fill: string | null, stroke: string | null) => void} */
function polygon(view, points, fill, stroke) {
  const spots = outline(view, points);
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
 * A colour in the light that falls along a normal.
 * @type {(theme: Theme, rgb: Rgb, normal: number[]) => Rgb}
 */
function lit(theme, rgb, normal) {
  const share = 1 - SUN / 2 + (SUN / 2) * dot(normal, LIGHT);
  return mixed([0, 0, 0], rgb, clamp(share * (theme.dark ? 0.8 : 1.04), 0, 1));
}

/**
 * Sky, ground, obstacles and the robot.
 * @param {View} view
 * @param {Model} model
 * @param {Pose[]} poses of its bodies
 * @param {number[]} target that the ground fades around
 */
export function drawWorld(view, model, poses, target) {
  const solids = model.geoms.map((geom) => solidOf(geom, poses[geom.body]));
  const grounds = solids.filter((solid) => solid.geom.shape === "plane");
  drawSky(view);
  for (const ground of grounds) drawGround(view, ground, target);
  const bodies = solids.filter((solid) => solid.geom.shape !== "plane" && !isLink(solid.geom));
  const links = solids.filter((solid) => isLink(solid.geom));
  for (const ground of grounds) drawShadows(view, ground, [...links, ...bodies.filter((b) => b.geom.robot)]);
  drawInOrder(view, bodies, links, null);
}

/**
 * The robot alone, its bodies at their poses, in one colour.
 * @type {(view: View, model: Model, poses: Pose[], tint: Rgb) => void}
 */
export function drawRobot(view, model, poses, tint) {
  const solids = model.geoms.map((geom) => solidOf(geom, poses[geom.body]));
  const links = solids.filter((solid) => isLink(solid.geom));
  const bodies = solids.filter((solid) => solid.geom.robot && !isLink(solid.geom));
  drawInOrder(view, bodies, links, tint);
}

/** @type {(view: View, bodies: Solid[], links: Solid[], tint: Rgb | null) => void} */
function drawInOrder(view, bodies, links, tint) {
  const order = backToFront(bodies, view.eye);
  const layers = /** @type {{ depth: number, draw: () => void }[][]} */ ([...order, null].map(() => []));
  for (const link of links) {
    const [a, b] = link.points;
    const radius = link.geom.size?.[0] ?? 0.01;
    const along = plus(b, a, -1);
    const places = Array.from({ length: PIECES }, (_, k) => layerOf(plus(a, along, (k + 0.5) / PIECES), radius));
    for (let k = 0, from = 0; k < PIECES; k++) {
      if (k + 1 < PIECES && places[k + 1] === places[k]) continue;
      const [start, end] = [plus(a, along, from / PIECES), plus(a, along, (k + 1) / PIECES)];
      const depth = (seen(view, start)[2] + seen(view, end)[2]) / 2;
      layers[places[k]].push({ depth, draw: () => drawLink(view, start, end, radius, tint ?? link.geom.colour) });
      from = k + 1;
    }
  }
  layers.forEach((layer, k) => {
    layer.sort((a, b) => b.depth - a.depth).forEach((piece) => piece.draw());
    if (k < order.length) drawSolid(view, order[k], tint);
  });

  /**
   * Before which of the ordered bodies a piece is drawn: the first that hides it.
   * @type {(point: number[], radius: number) => number}
   */
  function layerOf(point, radius) {
    const towards = plus(view.eye, point, -1);
    const before = plus(point, towards, (1.5 * radius) / Math.hypot(...towards)); // what it touches does not hide it
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
 * A plane around the target, fading out, with a grid.
 * @type {(view: View, ground: Solid, target: number[]) => void}
 */
function drawGround(view, ground, target) {
  const { pen } = view.sheet;
  const [right, ahead, normal] = [0, 1, 2].map((k) => [ground.turn[k], ground.turn[3 + k], ground.turn[6 + k]]);
  const [u, v] = [right, ahead].map((axis) => dot(axis, plus(target, ground.pos, -1)));
  const at = (/** @type {number} */ x, /** @type {number} */ y) => plus(plus(ground.pos, right, x), ahead, y);
  const below = dot(plus(view.eye, ground.pos, -1), normal) < 0;
  const soil = cssOf(view.theme.dark ? [46, 52, 55] : [226, 230, 225], below ? 0.15 : 0.34);
  const ring = (/** @type {number} */ radius) =>
    Array.from({ length: 40 }, (_, k) => at(u + radius * Math.cos(k / 6.3662), v + radius * Math.sin(k / 6.3662)));
  for (let k = 0; k < 8; k++) polygon(view, ring(REACH * (1 - k / 10)), soil, null);
  const ink = view.theme.dark ? [120, 132, 140] : [120, 132, 126];
  pen.lineWidth = 1;
  const [x, y] = [u, v].map((value) => Math.round(value / GRID) * GRID);
  GRID_LINES.forEach((lines, level) => {
    pen.strokeStyle = cssOf(/** @type {Rgb} */ (ink), (0.34 * (GRID_LINES.length - level)) / GRID_LINES.length);
    pen.beginPath();
    for (const [k, from, to] of lines)
      for (const [p, q] of [
        [at(x + k, y + from), at(x + k, y + to)],
        [at(x + from, y + k), at(x + to, y + k)],
      ]) {
        const [a, b] = outline(view, [p, q, q]);
        if (!b) continue;
        pen.moveTo(a.x, a.y);
        pen.lineTo(b.x, b.y);
      }
    pen.stroke();
  });
}

/**
 * What falls on a plane from above along its normal, soft.
 * @type {(view: View, ground: Solid, casting: Solid[]) => void}
 */
function drawShadows(view, ground, casting) {
  const normal = [ground.turn[2], ground.turn[5], ground.turn[8]];
  const { pen } = view.sheet;
  const fallen = (/** @type {number[]} */ point) => {
    const height = dot(plus(point, ground.pos, -1), normal);
    return { spot: plus(point, normal, -height), height };
  };
  pen.lineCap = "round";
  for (const solid of casting) {
    const spots = solid.points.map(fallen);
    const height = spots.reduce((sum, { height }) => sum + height, 0) / spots.length;
    const opacity = (view.theme.dark ? 0.4 : 0.16) / (1 + Math.max(0, height));
    if (isLink(solid.geom)) {
      const [a, b] = outline(view, [spots[0].spot, spots[1].spot, spots[1].spot]);
      if (!b) continue;
      pen.strokeStyle = cssOf([0, 0, 0], opacity);
      pen.lineWidth = ((2.4 * (solid.geom.size?.[0] ?? 0.01)) / ((a.depth + b.depth) / 2)) * view.focus;
      straight(pen, a.x, a.y, b.x, b.y);
    } else if (solid.geom.shape === "box") {
      const shadow = cssOf([0, 0, 0], opacity / 2);
      for (const { points } of solid.faces.slice(4)) {
        const below = points.map((point) => fallen(point).spot);
        polygon(view, below, shadow, null);
      }
    }
  }
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
    if (dot(plus(face.points[0], view.eye, -1), face.normal) >= 0) continue;
    const colour = lit(view.theme, own, face.normal);
    const edge = face.edges ? cssOf(mixed(colour, view.theme.dark ? [0, 0, 0] : [255, 255, 255], 0.35)) : cssOf(colour);
    polygon(view, face.points, cssOf(colour), edge);
  }
}

/**
 * A ball with three circles around it, which show how it turns.
 * @type {(view: View, solid: Solid, own: Rgb) => void}
 */
function drawBall(view, solid, own) {
  const { pen } = view.sheet;
  const local = seen(view, solid.pos);
  if (local[2] < NEAR) return;
  const radius = solid.geom.size?.[0] ?? 0;
  const { x, y, depth } = onSheet(view, local);
  const size = (radius / Math.sqrt(Math.max(depth ** 2 - radius ** 2, 1e-6))) * view.focus;
  const light = pen.createRadialGradient(x + 0.25 * size, y - 0.4 * size, 0.1 * size, x, y, 1.1 * size);
  light.addColorStop(0, cssOf(mixed(own, [255, 255, 255], view.theme.dark ? 0.1 : 0.45)));
  light.addColorStop(1, cssOf(mixed(own, [0, 0, 0], 0.35)));
  pen.fillStyle = light;
  pen.beginPath();
  pen.arc(x, y, size, 0, 2 * Math.PI);
  pen.fill();
  pen.strokeStyle = cssOf(mixed(own, [0, 0, 0], 0.45), 0.6);
  pen.lineWidth = 1;
  for (let circle = 0; circle < 3; circle++) {
    let before = /** @type {Spot | null} */ (null);
    pen.beginPath();
    for (let k = 0; k <= 48; k++) {
      const angle = (2 * Math.PI * k) / 48;
      const point = [0, 0, 0];
      point[circle] = radius * Math.cos(angle);
      point[(circle + 1) % 3] = radius * Math.sin(angle);
      const out = rotated(solid.turn, point);
      const place = plus(solid.pos, out);
      const facing = dot(plus(view.eye, place, -1), out) > 0;
      const spot = facing ? onSheet(view, seen(view, place)) : null;
      if (spot && before) pen.lineTo(spot.x, spot.y);
      else if (spot) pen.moveTo(spot.x, spot.y);
      before = spot;
    }
    pen.stroke();
  }
}

/**
 * A limb: a thick line that tapers with distance, bright on the side of the light.
 * @type {(view: View, from: number[], to: number[], radius: number, rgb: Rgb) => void}
 */
function drawLink(view, from, to, radius, rgb) {
  const [a, b] = [seen(view, from), seen(view, to)];
  if (a[2] < NEAR || b[2] < NEAR) return;
  const { pen } = view.sheet;
  const [p, q] = [onSheet(view, a), onSheet(view, b)];
  const [r, s] = [Math.max((radius / a[2]) * view.focus, 1), Math.max((radius / b[2]) * view.focus, 1)];
  const colour = mixed([0, 0, 0], rgb, view.theme.dark ? 0.88 : 0.94);
  limb(p, q, r + 0.9, s + 0.9, cssOf(mixed(colour, [0, 0, 0], 0.45)));
  limb(p, q, r, s, cssOf(colour));
  const moved = (/** @type {Spot} */ { x, y, depth }, /** @type {number} */ size) => ({
    x: x - 0.3 * size,
    y: y - 0.34 * size,
    depth,
  });
  limb(moved(p, r), moved(q, s), 0.42 * r, 0.42 * s, cssOf(mixed(colour, [255, 255, 255], 0.36)));

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
 * Forces on the feet as arrows.
 * @param {View} view
 * @param {Model} model
 * @param {Pose[]} poses of its bodies
 * @param {Float64Array} force (18,) N
 * @param {{ metres: number, least: number }} arrow m per N, and the N below which there is none
 */
export function drawForces(view, model, poses, force, arrow) {
  const { pen } = view.sheet;
  const colour = view.theme.dark ? "#ffc24d" : "#e08e00";
  pen.lineCap = "round";
  model.feet.forEach(([body, ...place], foot) => {
    const pull = force.subarray(3 * foot, 3 * foot + 3);
    if (Math.hypot(...pull) <= arrow.least) return;
    const tail = plus(poses[body].pos, rotated(poses[body].turn, place));
    const [a, b] = [seen(view, tail), seen(view, plus(tail, pull, arrow.metres))];
    if (a[2] < NEAR || b[2] < NEAR) return;
    const [p, q] = [onSheet(view, a), onSheet(view, b)];
    const length = Math.hypot(q.x - p.x, q.y - p.y);
    const head = Math.min(9, length / 2);
    const angle = Math.atan2(q.y - p.y, q.x - p.x);
    const tip = (/** @type {number} */ back, /** @type {number} */ aside) =>
      /** @type {const} */ ([
        q.x - back * Math.cos(angle) - aside * Math.sin(angle),
        q.y - back * Math.sin(angle) + aside * Math.cos(angle),
      ]);
    for (const [stroke, wide] of /** @type {[string, number][]} */ ([
      [cssOf(view.theme.paper, 0.8), 5],
      [colour, 2.6],
    ])) {
      pen.strokeStyle = pen.fillStyle = stroke;
      pen.lineWidth = wide;
      straight(pen, p.x, p.y, ...tip(head, 0));
      pen.beginPath();
      pen.moveTo(q.x, q.y);
      pen.lineTo(...tip(head, head / 2));
      pen.lineTo(...tip(head, -head / 2));
      pen.closePath();
      pen.fill();
      if (wide > 4) pen.stroke();
    }
  });
}

/**
 * What the robot may be hidden behind, where its model's bodies are.
 * @type {(model: Model, poses: Pose[]) => Solid[]}
 */
export function obstaclesOf(model, poses) {
  const others = model.geoms.filter((geom) => !geom.robot && geom.shape !== "plane");
  return others.map((geom) => solidOf(geom, poses[geom.body]));
}

/**
 * Where the robot's base is, by the poses of its model's bodies.
 * @type {(model: Model, poses: Pose[]) => number[]}
 */
export function baseOf(model, poses) {
  const robot = model.geoms.find((geom) => geom.robot);
  return robot ? poses[robot.body].pos : [0, 0, 0];
}
