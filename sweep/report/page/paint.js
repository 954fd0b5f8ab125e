// Marks and cells put straight into the memory of an image: tens of thousands of them take milliseconds.

/** @typedef {import("./dom.js").Rgb} Rgb */

/**
 * @typedef {object} Pixels
 * @property {number} width
 * @property {number} height
 * @property {Uint32Array} colours
 * @property {Int32Array} owner the row that a pixel shows, -1 for none
 * @property {ImageData} image
 */

/**
 * @param {number} width
 * @param {number} height
 * @returns {Pixels}
 */
export function pixelsOf(width, height) {
  const image = new ImageData(Math.max(1, width), Math.max(1, height));
  const owner = new Int32Array(image.width * image.height).fill(-1);
  return { width: image.width, height: image.height, colours: new Uint32Array(image.data.buffer), owner, image };
}

const TILE = 8;

/**
 * Whether a pattern has ink at a place of its tile of `TILE` pixels.
 * @param {string} pattern
 * @returns {Uint8Array | null} by line, null without a pattern
 */
export function tileOf(pattern) {
  if (!pattern) return null;
  const tile = new Uint8Array(TILE * TILE);
  const mark = pattern[0];
  const every = mark === "/" ? (pattern.length > 2 ? 4 : TILE) : TILE;
  for (let y = 0; y < TILE; y++)
    for (let x = 0; x < TILE; x++) {
      const falling = (x - y + TILE) % every === 0;
      const rising = (x + y) % every === 0;
      const away = Math.hypot(x - 3.5, y - 3.5);
      const ink = {
        "\\": falling,
        "/": rising,
        x: falling || rising,
        "+": x === 3 || y === 3,
        "-": y % 4 === 1,
        "|": x % 4 === 1,
        o: away > 1.8 && away < 3,
        ".": (x % 4 === 1 || x % 4 === 2) && (y % 4 === 1 || y % 4 === 2) && x < 4 === y < 4,
      }[mark];
      tile[y * TILE + x] = Number(ink ?? false);
    }
  return tile;
}

/**
 * Fill a rectangle of pixels; `ink` goes where the tile has it. Nothing is drawn beyond the image.
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

/** How marks of kinds differ beside their colour, in the order of kinds: success is a disc. */
const SHAPES = ["disc", "square", "up", "diamond", "cross", "down", "plus", "bar"];

/** @typedef {{ size: number, cover: Float32Array }} Stamp */

/**
 * How much of each pixel a mark covers.
 * @param {number} kind
 * @param {number} radius in pixels
 * @returns {Stamp}
 */
export function stampOf(kind, radius) {
  const size = 2 * Math.ceil(radius) + 1;
  const middle = size / 2;
  const cover = new Float32Array(size * size);
  const shape = SHAPES[kind % SHAPES.length];
  for (let k = 0; k < size * size * 16; k++) {
    const x = (k % (size * 4)) / 4 + 0.125;
    const y = Math.floor(k / (size * 4)) / 4 + 0.125;
    if (inside(shape, (x - middle) / radius, (y - middle) / radius))
      cover[Math.floor(y) * size + Math.floor(x)] += 1 / 16;
  }
  return { size, cover };
}

/**
 * Whether a place is in a mark of radius one.
 * @param {string} shape
 * @param {number} x
 * @param {number} y
 * @returns {boolean}
 */
function inside(shape, x, y) {
  const [wide, high] = [Math.abs(x), Math.abs(y)];
  switch (shape) {
    case "square":
      return wide < 0.85 && high < 0.85;
    case "up":
      return y < 0.75 && wide < (y + 1.05) * 0.6;
    case "down":
      return y > -0.75 && wide < (1.05 - y) * 0.6;
    case "diamond":
      return wide + high < 1.15;
    case "cross":
      return Math.abs(wide - high) < 0.38 && Math.max(wide, high) < 0.95;
    case "plus":
      return Math.min(wide, high) < 0.3 && Math.max(wide, high) < 1.1;
    case "bar":
      return high < 0.35 && wide < 1.1;
  }
  return x * x + y * y < 1;
}

/**
 * Put a mark into the image.
 * @param {Pixels} pixels
 * @param {Stamp} stamp
 * @param {number} x
 * @param {number} y
 * @param {Rgb} rgb
 * @param {number} opacity
 * @param {number} row that owns the pixels from then on; below -1 they keep their owner
 */
export function stampAt(pixels, stamp, x, y, rgb, opacity, row) {
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
 * The row that is shown at a place, or near it.
 * @param {Pixels} pixels
 * @param {number} x
 * @param {number} y
 * @param {number} reach in pixels
 * @returns {number} -1 for none
 */
export function ownerNear(pixels, x, y, reach) {
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
