// A pen that writes SVG: what views draw on a canvas, with lines and letters as such; cells and marks stay pixels.
import { element } from "./dom.js";

/** @typedef {[number, number, number, number, number, number]} Matrix */

const QUIET = 3; // frames without a new line after which a view has drawn all
const ANCHOR = /** @type {Record<string, string>} */ ({
  left: "start",
  start: "start",
  center: "middle",
  right: "end",
  end: "end",
});
const BASELINE = /** @type {Record<string, string>} */ ({
  top: "text-before-edge",
  middle: "central",
  bottom: "text-after-edge",
  alphabetic: "auto",
});

/** The part of a canvas's 2-D context that views use. */
class SvgPen {
  /** @param {CanvasRenderingContext2D} pen whose canvas and letters these are */
  constructor(pen) {
    this.canvas = pen.canvas;
    this.pen = pen;
    /** @type {string[]} */
    this.lines = [];
    /** @type {string[]} */
    this.path = [];
    /** @type {object[]} */
    this.states = [];
    /** @type {Matrix} */
    this.matrix = [1, 0, 0, 1, 0, 0];
    this.clips = 0;
    this.clipped = "";
    this.dash = /** @type {number[]} */ ([]);
    this.fillStyle = "#000";
    this.strokeStyle = "#000";
    this.lineWidth = 1;
    this.globalAlpha = 1;
    this.font = pen.font;
    this.lineJoin = "round";
    this.textAlign = "left";
    this.textBaseline = "alphabetic";
  }

  /** @param {string} tag @param {Record<string, unknown>} attributes @param {string} inner */
  put(tag, attributes, inner = "") {
    const { matrix, clipped, globalAlpha } = this;
    const all = /** @type {Record<string, unknown>} */ ({ ...attributes });
    if (globalAlpha < 1) all.opacity = shortened(globalAlpha);
    if (matrix.join() !== "1,0,0,1,0,0") all.transform = `matrix(${matrix.map(shortened).join(" ")})`;
    if (clipped) all["clip-path"] = `url(#${clipped})`;
    const told = Object.entries(all).map(([name, value]) => ` ${name}="${escaped(String(value))}"`);
    this.lines.push(`<${tag}${told.join("")}>${inner}</${tag}>`);
  }

  save() {
    const { pen, lines, path, states, ...state } = this;
    this.states.push(state);
  }
  restore() {
    Object.assign(this, this.states.pop(), { clips: this.clips });
  }
  /** @param {number} a @param {number} b */
  translate(a, b) {
    const [p, q, r, s, x, y] = this.matrix;
    this.matrix = [p, q, r, s, x + p * a + r * b, y + q * a + s * b];
  }
  /** @param {number} angle */
  rotate(angle) {
    const [p, q, r, s, x, y] = this.matrix;
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    this.matrix = [p * cos + r * sin, q * cos + s * sin, r * cos - p * sin, s * cos - q * sin, x, y];
  }
  setTransform() {
    this.matrix = [1, 0, 0, 1, 0, 0]; // a page of CSS pixels, as every sheet is
  }
  clearRect() {
    this.lines = [];
  }
  beginPath() {
    this.path = [];
  }
  /** @param {number} x @param {number} y */
  moveTo(x, y) {
    this.path.push(`M${shortened(x)} ${shortened(y)}`);
  }
  /** @param {number} x @param {number} y */
  lineTo(x, y) {
    this.path.push(`${this.path.length ? "L" : "M"}${shortened(x)} ${shortened(y)}`);
  }
  closePath() {
    this.path.push("Z");
  }
  /** @param {number[]} box */
  rect(...box) {
    const [x, y, width, height] = box.map(shortened);
    this.path.push(`M${x} ${y}h${width}v${height}h${-width}Z`);
  }
  /** @param {number} x @param {number} y @param {number} radius a whole circle, as views have no other arcs */
  arc(x, y, radius) {
    const [u, v, r] = [x - radius, y, radius].map(shortened);
    this.path.push(`M${u} ${v}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`);
  }
  stroke() {
    if (this.path.length) this.put("path", { d: this.path.join(""), fill: "none", ...this.stroked() });
  }
  fill() {
    if (this.path.length) this.put("path", { d: this.path.join(""), fill: this.fillStyle });
  }
  clip() {
    const name = `clip${++this.clips}`;
    this.lines.push(`<clipPath id="${name}"><path d="${this.path.join("")}"/></clipPath>`);
    this.clipped = name;
  }
  /** @param {number} x @param {number} y @param {number} width @param {number} height */
  fillRect(x, y, width, height) {
    this.put("rect", { ...boxOf(x, y, width, height), fill: this.fillStyle });
  }
  /** @param {number} x @param {number} y @param {number} width @param {number} height */
  strokeRect(x, y, width, height) {
    this.put("rect", { ...boxOf(x, y, width, height), fill: "none", ...this.stroked() });
  }
  stroked() {
    const { strokeStyle, lineWidth, lineJoin, dash } = this;
    const look = { stroke: strokeStyle, "stroke-width": lineWidth, "stroke-linejoin": lineJoin };
    return dash.length ? { ...look, "stroke-dasharray": dash.join(" ") } : look;
  }
  /** @param {number[]} dash */
  setLineDash(dash) {
    this.dash = dash;
  }
  /** @param {string} text */
  measureText(text) {
    this.pen.font = this.font;
    return this.pen.measureText(text);
  }
  /** @param {string} text @param {number} x @param {number} y @param {number} [most] */
  fillText(text, x, y, most) {
    this.written(text, x, y, most, { fill: this.fillStyle });
  }
  /** @param {string} text @param {number} x @param {number} y @param {number} [most] */
  strokeText(text, x, y, most) {
    this.written(text, x, y, most, { fill: "none", ...this.stroked() });
  }
  /** @param {string} text @param {number} x @param {number} y @param {number | undefined} most @param {Record<string, unknown>} look */
  written(text, x, y, most, look) {
    const { font, textAlign, textBaseline } = this;
    const [, bold, size, family] = font.match(/^(bold )?(?:.* )?([\d.]+)px (.*)$/) ?? [];
    const tight = most !== undefined && this.measureText(text).width > most;
    const fit = tight ? { textLength: shortened(most), lengthAdjust: "spacingAndGlyphs" } : {};
    const place = { x: shortened(x), y: shortened(y), "text-anchor": ANCHOR[textAlign] };
    const letters = { "font-family": family, "font-size": size, ...(bold ? { "font-weight": "bold" } : {}) };
    this.put(
      "text",
      { ...place, "dominant-baseline": BASELINE[textBaseline], ...letters, ...fit, ...look },
      escaped(text),
    );
  }
  /** @param {ImageData} image @param {number} x @param {number} y */
  putImageData(image, x, y) {
    const whole = element("canvas", { width: String(image.width), height: String(image.height) });
    /** @type {CanvasRenderingContext2D} */ (whole.getContext("2d")).putImageData(image, 0, 0);
    this.pixels(whole, x / this.ratio, y / this.ratio, image.width / this.ratio, image.height / this.ratio);
  }
  /** @param {HTMLCanvasElement} source @param {number} x @param {number} y @param {number} width @param {number} height */
  drawImage(source, x, y, width = source.width / this.ratio, height = source.height / this.ratio) {
    this.pixels(source, x, y, width, height);
  }
  /** @param {HTMLCanvasElement} source @param {number} x @param {number} y @param {number} width @param {number} height */
  pixels(source, x, y, width, height) {
    if (source.width && source.height)
      this.put("image", { ...boxOf(x, y, width, height), href: source.toDataURL(), preserveAspectRatio: "none" });
  }
  get ratio() {
    return this.canvas.width / this.canvas.clientWidth;
  }
}

/**
 * What is drawn on canvases that lie over each other, as SVG, when everything is drawn again.
 * @param {HTMLCanvasElement[]} layers
 * @param {string} ground
 * @param {() => void} redraw
 * @returns {Promise<string>}
 */
export async function svgOf(layers, ground, redraw) {
  const pens = layers.map((canvas) => new SvgPen(/** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"))));
  layers.forEach((canvas, k) => Object.assign(canvas, { getContext: () => pens[k] }));
  redraw();
  const count = () => pens.reduce((sum, { lines }) => sum + lines.length, 0);
  for (let quiet = 0, before = -1; quiet < QUIET; before = count()) {
    await new Promise(requestAnimationFrame);
    quiet = count() && count() === before ? quiet + 1 : 0;
  }
  for (const canvas of layers) Reflect.deleteProperty(canvas, "getContext");
  redraw();
  const [{ clientWidth: width, clientHeight: height }] = layers;
  const head = `xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}"`;
  const back = `<rect width="${width}" height="${height}" fill="${ground}"/>`;
  return `<svg ${head}>\n${back}\n${pens.flatMap(({ lines }) => lines).join("\n")}\n</svg>\n`;
}

/** @param {number} x @param {number} y @param {number} width @param {number} height */
function boxOf(x, y, width, height) {
  return { x: shortened(x), y: shortened(y), width: shortened(width), height: shortened(height) };
}

/** @param {number} value @returns {number} a hundredth of a pixel is enough */
function shortened(value) {
  return Math.round(100 * value) / 100;
}

/** @param {string} text @returns {string} */
function escaped(text) {
  return text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;").replaceAll('"', "&quot;");
}
