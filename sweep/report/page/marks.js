// Marks and cells as paths, for pictures that are saved as vectors.
import { cssColour } from "./dom.js";
import { GLYPH_SIZE } from "./raster.js";
import { VectorPen } from "./vector.js";

/** @import { Look, Rgb } from "./dom.js" */

export const MAX_VECTORS = 5000; // marks or cells that a saved drawing has as paths; more are an image
const HATCH_STEP = 4; // CSS pixels between the lines of a hatching, along a side
const GLYPH_OPACITY = 0.8;

/**
 * Whether a pen records a vector drawing.
 * @type {(pen: CanvasRenderingContext2D) => boolean}
 */
export function isVectorPen(pen) {
  return /** @type {unknown} */ (pen) instanceof VectorPen;
}

/**
 * Fill a mark.
 * @param {CanvasRenderingContext2D} pen that records a vector drawing
 * @param {number[]} shape corners for a radius of one, x and y in turn, y up
 * @param {number} x
 * @param {number} y
 * @param {number} radius
 * @param {Rgb} rgb
 * @param {number} opacity
 */
export function fillMark(pen, shape, x, y, radius, rgb, opacity) {
  pen.fillStyle = cssColour(rgb, opacity);
  /** @type {VectorPen} */ (/** @type {unknown} */ (pen)).fillMark(shape, x, y, radius);
}

/**
 * Fill a cell of a kind: its colour or hatching, and its glyph if that fits.
 * @type {(pen: CanvasRenderingContext2D, x: number, y: number, width: number, height: number, look: Look, glyph: boolean)
 *   => void}
 */
export function fillKindCell(pen, x, y, width, height, look, glyph) {
  pen.fillStyle = cssColour(look.cell);
  pen.fillRect(x, y, width, height);
  if (look.hatched) {
    pen.strokeStyle = cssColour(look.ink);
    pen.lineWidth = 1;
    pen.beginPath();
    for (let from = HATCH_STEP / 2 - height; from < width; from += HATCH_STEP) {
      const [start, end] = [Math.max(from, 0), Math.min(from + height, width)]; // along the diagonal, from below
      pen.moveTo(x + start, y + height - (start - from));
      pen.lineTo(x + end, y + height - (end - from));
    }
    pen.stroke();
  }
  if (glyph && look.glyphed)
    fillMark(pen, look.shape, x + width / 2, y + height / 2, GLYPH_SIZE, look.ink, GLYPH_OPACITY);
}
