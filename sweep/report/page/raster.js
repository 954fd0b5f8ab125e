// Marks and cells written directly into image memory: tens of thousands take milliseconds.
import { packRgb } from "./numbers.js";

/** @import { Look, Rgb } from "./dom.js" */
/** @typedef {{ left: number, top: number, right: number, bottom: number }} Edges */

/**
 * @typedef {object} Pixels
 * @property {number} width
 * @property {number} height
 * @property {Uint32Array} colours
 * @property {Int32Array} owner row that a pixel shows, -1 for none
 * @property {ImageData} image
 */

/** @type {(width: number, height: number) => Pixels} */
export function makePixels(width, height) {
  const image = new ImageData(Math.max(1, width), Math.max(1, height));
  const owner = new Int32Array(image.width * image.height).fill(-1);
  return { width: image.width, height: image.height, colours: new Uint32Array(image.data.buffer), owner, image };
}

export const GLYPH_SIZE = 3.8; // CSS pixels for a glyph's radius of one

const TILE = 8;

/** Hatching of what is invalid. */
const HATCHING = Uint8Array.from({ length: TILE * TILE }, (_, k) => Number(((k % TILE) + (k >> 3)) % 4 === 0));

/**
 * Fill a rectangle of pixels, with `ink` where the tile is set, clipped to the image.
 * @param {Pixels} pixels
 * @param {number} left
 * @param {number} top
 * @param {number} right
 * @param {number} bottom
 * @param {number} colour
 * @param {number} row
 * @param {Uint8Array | null} tile
 * @param {number} ink
 * @param {number} ratio device pixels of a tile's pixel
 */
export function fillCell(pixels, left, top, right, bottom, colour, row, tile, ink, ratio) {
  const { width, height, colours, owner } = pixels;
  const [x0, x1] = [Math.max(0, left), Math.min(width, right)];
  for (let y = Math.max(0, top); y < Math.min(height, bottom); y++) {
    const line = y * width;
    colours.fill(colour, line + x0, line + Math.max(x0, x1));
    owner.fill(row, line + x0, line + Math.max(x0, x1));
    if (!tile) continue;
    const tileLine = (Math.floor(y / ratio) % TILE) * TILE;
    for (let x = x0; x < x1; x++) if (tile[tileLine + (Math.floor(x / ratio) % TILE)]) colours[line + x] = ink;
  }
}

/** @typedef {{ size: number, cover: Float32Array }} Stamp */

/**
 * Compute the coverage of each pixel by a mark.
 * `shape` has the corners for a radius of one, `radius` is in pixels.
 * @type {(shape: number[], radius: number) => Stamp}
 */
export function makeStamp(shape, radius) {
  const size = 2 * Math.ceil(1.3 * radius) + 1;
  const middle = size / 2;
  const cover = new Float32Array(size * size);
  for (let k = 0; k < size * size * 16; k++) {
    const x = (k % (size * 4)) / 4 + 0.125;
    const y = Math.floor(k / (size * 4)) / 4 + 0.125;
    if (isInside(shape, (x - middle) / radius, (middle - y) / radius))
      cover[Math.floor(y) * size + Math.floor(x)] += 1 / 16;
  }
  return { size, cover };
}

/**
 * Whether a point is inside a polygon, by the even-odd rule.
 * @type {(shape: number[], x: number, y: number) => boolean}
 */
function isInside(shape, x, y) {
  let odd = false;
  const count = shape.length;
  for (let k = 0; k < count; k += 2) {
    const [u, v, p, q] = [shape[k], shape[k + 1], shape[(k + 2) % count], shape[(k + 3) % count]];
    if (v > y !== q > y && x < u + ((y - v) / (q - v)) * (p - u)) odd = !odd;
  }
  return odd;
}

/**
 * Draw a mark into the image.
 * @param {Pixels} pixels
 * @param {Stamp} stamp
 * @param {number} x
 * @param {number} y
 * @param {Rgb} rgb
 * @param {number} opacity
 * @param {number} row that owns the pixels from then on; below -1 they keep their owner
 */
export function drawStamp(pixels, stamp, x, y, rgb, opacity, row) {
  const { width, height, colours, owner } = pixels;
  const left = Math.round(x) - (stamp.size >> 1);
  const top = Math.round(y) - (stamp.size >> 1);
  for (let j = 0; j < stamp.size; j++) {
    const line = top + j;
    if (line < 0 || line >= height) continue;
    for (let i = 0; i < stamp.size; i++) {
      const column = left + i;
      const share = stamp.cover[j * stamp.size + i] * opacity;
      if (share <= 0 || column < 0 || column >= width) continue;
      const at = line * width + column;
      const below = colours[at];
      const red = (below & 255) + (rgb[0] - (below & 255)) * share;
      const green = ((below >> 8) & 255) + (rgb[1] - ((below >> 8) & 255)) * share;
      const blue = ((below >> 16) & 255) + (rgb[2] - ((below >> 16) & 255)) * share;
      colours[at] = (0xff000000 | (blue << 16) | (green << 8) | red) >>> 0;
      if (row > -2 && share > 0.2) owner[at] = row;
    }
  }
}

/**
 * Row shown at a place, or up to `reach` pixels from it; -1 for none.
 * @type {(pixels: Pixels, x: number, y: number, reach: number) => number}
 */
export function rowNear(pixels, x, y, reach) {
  const { width, height, owner } = pixels;
  let best = -1;
  let least = Infinity;
  for (let j = Math.max(0, Math.floor(y - reach)); j <= Math.min(height - 1, y + reach); j++)
    for (let i = Math.max(0, Math.floor(x - reach)); i <= Math.min(width - 1, x + reach); i++) {
      const row = owner[j * width + i];
      const away = (i - x) ** 2 + (j - y) ** 2;
      if (row >= 0 && away < least) [best, least] = [row, away];
    }
  return best;
}

/**
 * Make the glyph on the cells of a kind, the shape of a cause of failure.
 * @type {(look: Look, ratio: number) => Stamp | null}
 */
export function makeGlyph({ glyphed, shape }, ratio) {
  return glyphed ? makeStamp(shape, GLYPH_SIZE * ratio) : null;
}

/**
 * Paint a cell of a kind, with the glyph of its cause if it fits.
 * @type {(pixels: Pixels, box: Edges, look: Look, glyph: Stamp | null, row: number, ratio: number) => void}
 */
export function paintKind(pixels, { left, top, right, bottom }, look, glyph, row, ratio) {
  const hatching = look.hatched ? HATCHING : null;
  fillCell(pixels, left, top, right, bottom, packRgb(...look.cell), row, hatching, packRgb(...look.ink), ratio);
  if (glyph) drawStamp(pixels, glyph, (left + right) / 2, (top + bottom) / 2, look.ink, 0.8, -2);
}
