// A canvas pen that records drawing as SVG.

const ANCHORS = /** @type {Record<string, string>} */ ({ center: "middle", right: "end", end: "end" });
const DROPS = /** @type {Record<string, number>} */ ({ top: 0.8, middle: 0.32, bottom: -0.2 }); // baseline shift of text, in font sizes

let named = 0; // counter for unique names of gradients and clips, over all pens

/** @param {unknown} value */
const escapeText = (value) => String(value).replace(/[&<>"]/g, (one) => `&#${one.charCodeAt(0)};`);
/** @param {number} value */
const formatCoordinate = (value) => String(Math.round(value * 100) / 100);

/** A gradient as elements of SVG. */
class Gradient {
  /**
   * @param {string} kind
   * @param {Record<string, number>} ends
   */
  constructor(kind, ends) {
    this.name = `paint${named++}`;
    const attributes = Object.entries(ends).map(([name, value]) => ` ${name}="${formatCoordinate(value)}"`);
    this.text = `<${kind} id="${this.name}" gradientUnits="userSpaceOnUse"${attributes.join("")}>`;
    this.end = `</${kind}>`;
  }

  /** @type {(offset: number, colour: string) => void} */
  addColorStop(offset, colour) {
    this.text += `<stop offset="${offset}" stop-color="${escapeText(colour)}"/>`;
  }
}

/** As much of a canvas' pen as the views use. Coordinates are CSS pixels; pixels that are put are the screen's. */
export class VectorPen {
  /** @type {string | Gradient} */
  fillStyle = "#000";
  /** @type {string | Gradient} */
  strokeStyle = "#000";
  lineWidth = 1;
  lineCap = "butt";
  lineJoin = "miter";
  globalAlpha = 1;
  font = "10px sans-serif";
  textAlign = "start";
  textBaseline = "alphabetic";
  dash = "";
  moved = ""; // transform of text
  clipped = ""; // name of the present clip path
  path = "";
  ratio = 1;
  /** @type {object[]} */
  kept = [];
  /** @type {string[]} */
  parts = [];
  /** @type {Set<Gradient>} */
  gradients = new Set();
  /** @type {Map<string, string>} names of marks by their paths */
  marks = new Map();

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
  }

  /** @returns {string} all that was drawn since it was cleared */
  text() {
    const marks = [...this.marks].map(([path, name]) => `<path id="${name}" d="${path}"/>`);
    const defs = [...this.gradients].map((one) => one.text + one.end).join("") + marks.join("");
    const last = [...new Set(this.parts.reverse())].reverse(); // a frame that is drawn repeatedly is kept once
    return `<defs>${defs}</defs>${last.join("\n")}`;
  }

  /** @param {number} ratio */
  setTransform(ratio) {
    this.ratio = ratio;
  }

  clearRect() {
    this.parts = [];
    this.gradients.clear();
  }

  save() {
    const { fillStyle, strokeStyle, lineWidth, lineCap, lineJoin, globalAlpha, font, textAlign, textBaseline } = this;
    const { dash, moved, clipped } = this;
    const drawn = { fillStyle, strokeStyle, lineWidth, lineCap, lineJoin, globalAlpha, font, textAlign, textBaseline };
    this.kept.push({ ...drawn, dash, moved, clipped });
  }

  restore() {
    Object.assign(this, this.kept.pop());
  }

  /**
   * Only text is affected by the transform.
   * @type {(x: number, y: number) => void}
   */
  translate(x, y) {
    this.moved += `translate(${formatCoordinate(x)} ${formatCoordinate(y)})`;
  }

  /** @param {number} angle */
  rotate(angle) {
    this.moved += `rotate(${formatCoordinate((angle * 180) / Math.PI)})`;
  }

  /** @param {number[]} dash */
  setLineDash(dash) {
    this.dash = dash.join(" ");
  }

  beginPath() {
    this.path = "";
  }

  closePath() {
    this.path += "Z";
  }

  /** @type {(x: number, y: number) => void} */
  moveTo(x, y) {
    this.path += `M${formatCoordinate(x)} ${formatCoordinate(y)}`;
  }

  /** @type {(x: number, y: number) => void} */
  lineTo(x, y) {
    this.path += `${this.path ? "L" : "M"}${formatCoordinate(x)} ${formatCoordinate(y)}`;
  }

  /** @type {(x: number, y: number, width: number, height: number) => void} */
  rect(x, y, width, height) {
    this.path += `M${formatCoordinate(x)} ${formatCoordinate(y)}h${formatCoordinate(width)}v${formatCoordinate(height)}h${formatCoordinate(-width)}Z`;
  }

  /**
   * Draws clockwise, a full circle for angles one turn apart.
   * @type {(x: number, y: number, radius: number, from: number, to: number) => void}
   */
  arc(x, y, radius, from, to) {
    const turn = to - from >= 2 * Math.PI ? 2 * Math.PI : (((to - from) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI);
    const at = (/** @type {number} */ angle) => [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
    this.lineTo(.../** @type {[number, number]} */ (at(from)));
    for (const angle of [from + turn / 2, from + turn])
      this.path += `A${formatCoordinate(radius)} ${formatCoordinate(radius)} 0 0 1 ${at(angle).map(formatCoordinate).join(" ")}`;
  }

  clip() {
    this.clipped = `clip${named++}`;
    this.parts.push(`<clipPath id="${this.clipped}"><path d="${this.path}"/></clipPath>`);
  }

  /** @type {(style: unknown) => string} */
  paint(style) {
    if (!(style instanceof Gradient)) return escapeText(style);
    this.gradients.add(style);
    return `url(#${style.name})`;
  }

  /**
   * @param {string} body start of an element
   * @param {string} end
   */
  add(body, end = "/>") {
    const { globalAlpha, clipped } = this;
    const alpha = globalAlpha < 1 ? ` opacity="${globalAlpha}"` : "";
    this.parts.push(`${body}${alpha}${clipped ? ` clip-path="url(#${clipped})"` : ""}${end}`);
  }

  /** @returns {string} */
  line() {
    const { strokeStyle, lineWidth, lineCap, lineJoin, dash } = this;
    const dashed = dash ? ` stroke-dasharray="${dash}"` : "";
    const ends = `${lineCap === "butt" ? "" : ` stroke-linecap="${lineCap}"`} stroke-linejoin="${lineJoin}"`;
    return ` stroke="${this.paint(strokeStyle)}" stroke-width="${formatCoordinate(lineWidth)}"${dashed}${ends}`;
  }

  fill() {
    if (this.path) this.add(`<path d="${this.path}" fill="${this.paint(this.fillStyle)}"`);
  }

  stroke() {
    if (this.path) this.add(`<path d="${this.path}" fill="none"${this.line()}`);
  }

  /**
   * Fill a mark: a polygon whose corners for a radius of one are x and y in turn, y up. Marks of one shape and size share
   * their path.
   * @type {(shape: number[], x: number, y: number, radius: number) => void}
   */
  fillMark(shape, x, y, radius) {
    const corners = shape.map((value, k) => formatCoordinate(radius * (k % 2 ? -value : value)));
    const path = `M${corners.join(" ")}Z`;
    const name = this.marks.get(path) ?? `mark${named++}`;
    this.marks.set(path, name);
    const place = `x="${formatCoordinate(x)}" y="${formatCoordinate(y)}"`;
    this.add(`<use href="#${name}" ${place} fill="${this.paint(this.fillStyle)}"`);
  }

  /** @type {(x: number, y: number, width: number, height: number) => void} */
  fillRect(x, y, width, height) {
    this.alone(x, y, width, height).fill();
  }

  /** @type {(x: number, y: number, width: number, height: number) => void} */
  strokeRect(x, y, width, height) {
    this.alone(x, y, width, height).stroke();
  }

  /**
   * Set the path to a rectangle.
   * @type {(x: number, y: number, width: number, height: number) => this}
   */
  alone(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    return this;
  }

  /** @type {(text: string) => TextMetrics} */
  measureText(text) {
    const pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    pen.font = this.font;
    return pen.measureText(text);
  }

  /** @type {(text: string, x: number, y: number, most?: number, paint?: string) => void} */
  fillText(text, x, y, most = Infinity, paint = ` fill="${this.paint(this.fillStyle)}"`) {
    const { font, textAlign, textBaseline, moved } = this;
    const [, bold, size, family] = /(bold )?(\d+)px (.*)/.exec(font) ?? [];
    const face = ` font-family="${escapeText(family)}" font-size="${size}"${bold ? ' font-weight="bold"' : ""}`;
    const anchor = ANCHORS[textAlign] ? ` text-anchor="${ANCHORS[textAlign]}"` : "";
    const narrow =
      this.measureText(text).width > most
        ? ` textLength="${formatCoordinate(most)}" lengthAdjust="spacingAndGlyphs"`
        : "";
    const base = y + (DROPS[textBaseline] ?? 0) * Number(size);
    const place = ` x="${formatCoordinate(x)}" y="${formatCoordinate(base)}"${moved ? ` transform="${moved}"` : ""}`;
    this.add(`<text${place}${face}${anchor}${narrow}${paint}`, `>${escapeText(text)}</text>`);
  }

  /** @type {(text: string, x: number, y: number, most?: number) => void} */
  strokeText(text, x, y, most = Infinity) {
    this.fillText(text, x, y, most, ` fill="none"${this.line()}`);
  }

  /** @type {(image: ImageData, x: number, y: number) => void} */
  putImageData(image, x, y) {
    const made = document.createElement("canvas");
    [made.width, made.height] = [image.width, image.height];
    made.getContext("2d")?.putImageData(image, 0, 0);
    this.drawImage(made, x / this.ratio, y / this.ratio, image.width / this.ratio, image.height / this.ratio);
  }

  /** @type {(image: HTMLCanvasElement, x: number, y: number, width: number, height: number) => void} */
  drawImage(image, x, y, width, height) {
    const place = ` x="${formatCoordinate(x)}" y="${formatCoordinate(y)}" width="${formatCoordinate(width)}" height="${formatCoordinate(height)}"`;
    this.add(`<image${place} preserveAspectRatio="none" href="${image.toDataURL()}"`);
  }

  /** @type {(x1: number, y1: number, x2: number, y2: number) => Gradient} */
  createLinearGradient(x1, y1, x2, y2) {
    return new Gradient("linearGradient", { x1, y1, x2, y2 });
  }

  /** @type {(fx: number, fy: number, fr: number, cx: number, cy: number, r: number) => Gradient} */
  createRadialGradient(fx, fy, fr, cx, cy, r) {
    return new Gradient("radialGradient", { fx, fy, fr, cx, cy, r });
  }
}
