// Elements, canvases and the colours of the page's theme.
import { clamp, parseColour } from "./numbers.js";
import { VectorPen } from "./vector.js";

/** @import { Column, Kind } from "./data.js" */
/** @typedef {[number, number, number]} Rgb */

export const CLICK_REACH = 5; // CSS pixels from which a click is a drag
const [TIP_DISTANCE, TIP_RISE] = [14, 30]; // CSS pixels of a tip's edge from its place, aside and upwards

/**
 * Find an element of the page by its id.
 * @type {(id: string) => HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/**
 * Make an element with attributes and children; strings become text nodes.
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {Record<string, string>} attributes
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/**
 * Make a button with attributes, children and an action.
 * @type {(attributes: Record<string, string>, pressed: () => void, ...children: (Node | string)[]) => HTMLButtonElement}
 */
export function makeButton(attributes, pressed, ...children) {
  const made = element("button", { type: "button", ...attributes }, ...children);
  made.addEventListener("click", pressed);
  return made;
}

/**
 * Options of a selection list, one for each column.
 * @type {(columns: Column[]) => [string, string, string][]}
 */
export function columnOptions(columns) {
  return columns.map(({ key, title, path }) => [key, title, path]);
}

/**
 * Fill a selection list; options are values, words, and what is shown on hover.
 * @type {(select: HTMLSelectElement, options: [string, string, string?][], chosen: string) => void}
 */
export function fillSelect(select, options, chosen) {
  select.replaceChildren(...options.map(([value, text, title = ""]) => element("option", { value, title }, text)));
  select.value = chosen;
}

/** @typedef {{ pen: CanvasRenderingContext2D, width: number, height: number, ratio: number }} Sheet */

/** @type {Map<HTMLCanvasElement, VectorPen>} pens that record what is drawn on these canvases while they are saved */
export const recorders = new Map();

/** Pixels of a drawing for each CSS pixel; 0 for the screen's. */
export const resolution = { ratio: 0 };

/**
 * Clear a canvas and prepare it for drawing in CSS pixels at the screen's resolution.
 * @type {(canvas: HTMLCanvasElement) => Sheet}
 */
export function prepareCanvas(canvas) {
  const ratio = resolution.ratio || Math.min(window.devicePixelRatio || 1, 2);
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const drawn = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const recorder = recorders.get(canvas);
  const pen = recorder ? /** @type {CanvasRenderingContext2D} */ (/** @type {unknown} */ (recorder)) : drawn;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  pen.lineJoin = "round";
  return { pen, width, height, ratio };
}

/**
 * Draw a straight line.
 * @type {(pen: CanvasRenderingContext2D, x: number, y: number, toX: number, toY: number) => void}
 */
export function drawLine(pen, x, y, toX, toY) {
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(toX, toY);
  pen.stroke();
}

/**
 * Shorten a text to fit into `room` CSS pixels.
 * @type {(pen: CanvasRenderingContext2D, text: string, room: number) => string}
 */
export function shortenToFit(pen, text, room) {
  let cut = text;
  for (let kept = text.length; kept > 0 && pen.measureText(cut).width > room; kept--) cut = `${text.slice(0, kept)}…`;
  return cut;
}

/**
 * Split a text at spaces into lines that fit into `room` CSS pixels.
 * @type {(pen: CanvasRenderingContext2D, text: string, room: number) => string[]}
 */
export function wrapToFit(pen, text, room) {
  /** @type {string[]} */
  const lines = [];
  for (const word of text.split(" ")) {
    const longer = lines.length ? `${lines[lines.length - 1]} ${word}` : word;
    if (lines.length && pen.measureText(longer).width <= room) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}

/**
 * @typedef {object} Theme
 * @property {boolean} dark
 * @property {Rgb} paper of panels
 * @property {string} ink
 * @property {string} soft
 * @property {string} line
 * @property {string} accent
 * @property {string} panel
 */

/**
 * Read the present colours from the style sheet.
 * @returns {Theme}
 */
export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const value = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  const dark = value("dark") === "1";
  const panel = value("panel");
  const [ink, soft, line, accent] = ["ink", "soft", "line", "accent"].map(value);
  return { dark, paper: parseColour(panel), ink, soft, line, accent, panel };
}

/** @typedef {{ cell: Rgb, mark: Rgb, ink: Rgb, hatched: boolean, glyphed: boolean, shape: number[] }} Look */

/**
 * Style of a kind of outcome: as a mark or a line, and as a cell with its glyph. Cells of invalid rows have the theme's
 * colours.
 * @type {(kind: Kind, theme: Theme) => Look}
 */
export function kindStyle({ colour, shape, outcome }, theme) {
  const mark = parseColour(colour);
  if (outcome === "invalid") return { cell: theme.paper, mark, ink: mark, hatched: true, glyphed: false, shape };
  const dark = 0.299 * mark[0] + 0.587 * mark[1] + 0.114 * mark[2] < 110;
  const ink = /** @type {Rgb} */ (dark ? [255, 255, 255] : [28, 32, 36]);
  return { cell: mark, mark, ink, hatched: false, glyphed: outcome === "failure", shape };
}

/** @type {(rgb: Rgb, opacity?: number) => string} */
export function cssColour(rgb, opacity = 1) {
  return `rgba(${rgb.map(Math.round).join(",")},${opacity})`;
}

/**
 * Show a tip beside a place of its box, on the side with more room, whole in the box where it fits.
 * @type {(tip: HTMLElement, x: number, y: number) => void}
 */
export function placeTip(tip, x, y) {
  const { clientWidth: width, clientHeight: height } = tip.offsetParent ?? document.body;
  const right = x < width / 2;
  tip.style.left = right ? `${x + TIP_DISTANCE}px` : "auto";
  tip.style.right = right ? "auto" : `${width - x + TIP_DISTANCE}px`;
  tip.style.top = `${clamp(y - TIP_RISE, 0, Math.max(0, height - tip.offsetHeight))}px`;
}

/**
 * Position of a pointer on an element, CSS pixels.
 * @type {(event: { clientX: number, clientY: number }, target: HTMLElement) => [number, number]}
 */
export function pointerPosition(event, target) {
  const box = target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}
