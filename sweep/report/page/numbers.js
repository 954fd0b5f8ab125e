// Numbers as text, ticks of axes, and colours of values.

const ROUNDING = 1e-9; // of a value: a smaller range is no difference between rollouts

/**
 * Format a number with four digits.
 * @type {(value: number) => string}
 */
export function formatShort(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-4)) return value.toExponential(2).replace("e+", "e");
  return String(Number(value.toPrecision(4)));
}

/**
 * Format the numbers of an axis with as many digits as tell them apart, four at least.
 * @type {(values: number[]) => string[]}
 */
export function formatApart(values) {
  const short = values.map(formatShort);
  for (let digits = 5; digits <= 15 && new Set(short).size < new Set(values).size; digits++)
    values.forEach((value, k) => (short[k] = String(Number(value.toPrecision(digits)))));
  return short;
}

/**
 * Whether a range is the rounding error of one value.
 * @type {(low: number, high: number) => boolean}
 */
export function isRoundingRange(low, high) {
  return !(high - low > ROUNDING * Math.max(Math.abs(low), Math.abs(high)));
}

/**
 * Format a count with separated thousands: 16,384.
 * @type {(count: number) => string}
 */
export function formatCount(count) {
  return String(count).replace(/\B(?=(\d{3})+$)/g, ",");
}

/**
 * Round numbers between two ends, about `count` of them.
 * @type {(low: number, high: number, count: number) => number[]}
 */
export function ticks(low, high, count) {
  if (!(high > low) || count < 1) return [low];
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].find((factor) => factor * power >= rough * 0.999) ?? 10);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    found.push(Number((k * step).toPrecision(12)));
  return found;
}

/** @type {(value: number, low: number, high: number) => number} */
export function clamp(value, low, high) {
  return Math.max(low, Math.min(high, value));
}

/**
 * Reproducible pseudo-random number of a row, from 0 to 999.
 * @type {(row: number) => number}
 */
export function rowLottery(row) {
  return ((row * 2654435761) >>> 8) % 1000;
}

/**
 * Edges of cells around sorted values, half-way between them.
 * @type {(values: ArrayLike<number>) => Float64Array}
 */
export function cellEdges(values) {
  const count = values.length;
  const edges = new Float64Array(count + 1);
  for (let k = 1; k < count; k++) edges[k] = (values[k - 1] + values[k]) / 2;
  const first = count > 1 ? (values[1] - values[0]) / 2 : Math.abs(values[0]) / 2 || 0.5;
  const last = count > 1 ? (values[count - 1] - values[count - 2]) / 2 : first;
  edges[0] = values[0] - first;
  if (values[0] >= 0) edges[0] = Math.max(edges[0], 0); // such as friction, which is never below zero
  edges[count] = values[count - 1] + last;
  return edges;
}

/**
 * Index of the last sorted number that is not above `value`; -1 below the first.
 * @type {(sorted: ArrayLike<number>, value: number) => number}
 */
export function lastIndexBelow(sorted, value) {
  let low = 0;
  let high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The scale of rates and figures, dark to light, which the colour-blind can read (cividis). */
const SCALE = [0x00224e, 0x123570, 0x3b496c, 0x575d6d, 0x707173, 0x8a8678, 0xa59c74, 0xc3b369, 0xe1cc55, 0xfee838];

/** The scale of what is good above zero and bad below it: dark orange, white at zero, dark blue. */
const DIVERGING = [0x7a2e00, 0xb24a00, 0xe08214, 0xfdc583, 0xf5f2ee, 0xb6dbf2, 0x6db3e0, 0x2878b5, 0x0b3c6f];

/**
 * Colour of a share between 0 and 1, packed by `packRgb`; a diverging scale has its middle at 0.5.
 * @type {(share: number, diverging?: boolean) => number}
 */
export function scaleColour(share, diverging = false) {
  const scale = diverging ? DIVERGING : SCALE;
  const at = clamp(share, 0, 1) * (scale.length - 1);
  const k = Math.min(Math.floor(at), scale.length - 2);
  const part = (/** @type {number} */ shift) => {
    const from = (scale[k] >> shift) & 255;
    return from + (((scale[k + 1] >> shift) & 255) - from) * (at - k);
  };
  return packRgb(part(16), part(8), part(0));
}

/**
 * Pack an opaque colour into a pixel of `ImageData`.
 * @type {(red: number, green: number, blue: number) => number}
 */
export function packRgb(red, green, blue) {
  return ((255 << 24) | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;
}

/**
 * Parse a colour such as `#D55E00`.
 * @type {(hex: string) => [number, number, number]}
 */
export function parseColour(hex) {
  const value = parseInt(hex.slice(1), 16);
  return [(value >> 16) & 255, (value >> 8) & 255, value & 255];
}

/**
 * Interpolate between two colours.
 * @type {(from: [number, number, number], to: [number, number, number], share: number) => [number, number, number]}
 */
export function mixColours(from, to, share) {
  const part = (/** @type {number} */ k) => from[k] + (to[k] - from[k]) * share;
  return [part(0), part(1), part(2)];
}

/**
 * Map a number to a scale that is linear within `linear` of zero and logarithmic beyond (inverse hyperbolic sine).
 * @type {(value: number, linear: number) => number}
 */
export function arcsinh(value, linear) {
  return Math.asinh(value / linear);
}

/**
 * Inverse of `arcsinh`.
 * @type {(length: number, linear: number) => number}
 */
export function inverseArcsinh(length, linear) {
  return linear * Math.sinh(length);
}

/**
 * Wilson's 95 % confidence interval of a rate.
 * @type {(good: number, total: number) => [number, number]}
 */
export function wilsonInterval(good, total) {
  if (!total) return [NaN, NaN];
  const z = 1.959964;
  const rate = good / total;
  const middle = (rate + (z * z) / (2 * total)) / (1 + (z * z) / total);
  const half = (z / (1 + (z * z) / total)) * Math.sqrt((rate * (1 - rate)) / total + (z * z) / (4 * total * total));
  return [good === 0 ? 0 : middle - half, good === total ? 1 : middle + half];
}
