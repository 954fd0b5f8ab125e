// Elements, canvases and the colours of the page's theme.
import { rgbOf } from "./numbers.js";
import { VectorPen } from "./vector.js";

/** @import { Column, Kind } from "./data.js" */
/** @typedef {[number, number, number]} Rgb */

/**
 * The element with an id of the page.
 * @type {(id: string) => HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/**
 * An element with attributes, and with children of which strings are text and nothing else.
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
 * A button with attributes and children, and what it does when it is pressed.
 * @type {(attributes: Record<string, string>, pressed: () => void, ...children: (Node | string)[]) => HTMLButtonElement}
 */
export function buttonOf(attributes, pressed, ...children) {
  const made = element("button", { type: "button", ...attributes }, ...children);
  made.addEventListener("click", pressed);
  return made;
}

/**
 * Columns as options of a selection list.
 * @type {(columns: Column[]) => [string, string, string][]}
 */
export function optionsOf(columns) {
  return columns.map(({ key, title, path }) => [key, title, path]);
}

/**
 * Fill a selection list; options are values, words, and what is shown on hover.
 * @type {(select: HTMLSelectElement, options: [string, string, string?][], chosen: string) => void}
 */
export function offer(select, options, chosen) {
  select.replaceChildren(...options.map(([value, text, title = ""]) => element("option", { value, title }, text)));
  select.value = chosen;
}

/** @typedef {{ pen: CanvasRenderingContext2D, width: number, height: number, ratio: number }} Sheet */

/** @type {Map<HTMLCanvasElement, VectorPen>} pens that write down what is drawn on these canvases, while it is saved */
export const recorders = new Map();

/**
 * A canvas ready to be drawn on in CSS pixels, as sharp as the screen, cleared.
 * @type {(canvas: HTMLCanvasElement) => Sheet}
 */
export function sheetOf(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
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
 * A straight line.
 * @type {(pen: CanvasRenderingContext2D, x: number, y: number, toX: number, toY: number) => void}
 */
export function straight(pen, x, y, toX, toY) {
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(toX, toY);
  pen.stroke();
}

/**
 * A text, cut short where there is no room (in pixels) for all of it: squeezed into it nobody could read it.
 * @type {(pen: CanvasRenderingContext2D, text: string, room: number) => string}
 */
export function fitting(pen, text, room) {
  let cut = text;
  for (let kept = text.length; kept > 0 && pen.measureText(cut).width > room; kept--) cut = `${text.slice(0, kept)}…`;
  return cut;
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
 * The colours that the style sheet gives now.
 * @returns {Theme}
 */
export function themeNow() {
  const style = getComputedStyle(document.documentElement);
  const value = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  const dark = value("dark") === "1";
  const panel = value("panel");
  const [ink, soft, line, accent] = ["ink", "soft", "line", "accent"].map(value);
  return { dark, paper: rgbOf(panel), ink, soft, line, accent, panel };
}

/** @typedef {{ cell: Rgb, mark: Rgb, ink: Rgb, hatched: boolean, glyphed: boolean, shape: number[] }} Look */

/**
 * How a kind of outcome looks, whatever the theme: as a mark or a line, and as a cell with its glyph. What is invalid has no
 * colour of its own as a cell.
 * @type {(kind: Kind, theme: Theme) => Look}
 */
export function lookOf({ colour, shape, outcome }, theme) {
  const mark = rgbOf(colour);
  if (outcome === "invalid") return { cell: theme.paper, mark, ink: mark, hatched: true, glyphed: false, shape };
  const dark = 0.299 * mark[0] + 0.587 * mark[1] + 0.114 * mark[2] < 110;
  const ink = /** @type {Rgb} */ (dark ? [255, 255, 255] : [28, 32, 36]);
  return { cell: mark, mark, ink, hatched: false, glyphed: outcome === "failure", shape };
}

/** @type {(rgb: Rgb, opacity?: number) => string} */
export function cssOf(rgb, opacity = 1) {
  return `rgba(${rgb.map(Math.round).join(",")},${opacity})`;
}

/**
 * Where a pointer is on an element.
 * @type {(event: { clientX: number, clientY: number }, target: HTMLElement) => [number, number]}
 */
export function pointerOn(event, target) {
  const box = target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}
