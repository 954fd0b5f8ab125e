// Zero contour of a metric on a map: straight lines across the cells of a grid or a refined mesh.

/** @import { PlacedRows } from "./cells.js" */

/**
 * Zero contour of a metric between the middles of a grid's cells, or the corners of a mesh's. Several rollouts in a cell
 * are averaged.
 * @param {PlacedRows} here
 * @param {(row: number) => number} value NaN if missing
 * @returns {number[]} left, low, right and high of each piece, as shares of the axes
 */
export function zeroLines(here, value) {
  const found = /** @type {number[]} */ ([]);
  for (const corners of here.outlines.length ? meshCorners(here, value) : gridCorners(here, value)) {
    const crossed = [0, 1, 2, 3].flatMap((k) => {
      const [[x, y, a], [u, v, b]] = [corners[k], corners[(k + 1) % 4]];
      if (!(a > 0 !== b > 0) || Number.isNaN(a + b)) return [];
      const share = a / (a - b);
      return [[x + share * (u - x), y + share * (v - y)]];
    });
    if (corners.some(([, , one]) => Number.isNaN(one))) continue;
    for (let k = 0; k + 1 < crossed.length; k += 2) found.push(...crossed[k], ...crossed[k + 1]);
  }
  return found;
}

/** @typedef {[number, number, number][]} Corners around a cell: places and values */

/** @type {(here: PlacedRows, value: (row: number) => number) => Generator<Corners>} */
function* gridCorners({ x, y, rows, cell, form }, value) {
  if (form !== "cells" || !x.cells || !y.cells) return;
  const [across, up] = [x.cells, y.cells];
  const [sum, count] = [new Float64Array(across.length * up.length), new Int32Array(across.length * up.length)];
  rows.forEach((row, k) => {
    const one = value(row);
    if (Number.isNaN(one)) return;
    sum[cell[k]] += one;
    count[cell[k]]++;
  });
  const corner = (/** @type {number} */ i, /** @type {number} */ j) => {
    const at = j * across.length + i;
    return /** @type {[number, number, number]} */ ([x.to(across[i]), y.to(up[j]), sum[at] / count[at]]);
  };
  for (let j = 0; j + 1 < up.length; j++)
    for (let i = 0; i + 1 < across.length; i++)
      yield [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
}

/** @type {(here: PlacedRows, value: (row: number) => number) => Generator<Corners>} */
function* meshCorners({ rows, outlines }, value) {
  for (let k = 0; k < outlines.length; k += 4) {
    const [left, low, right, high] = outlines.subarray(k, k + 4);
    const [a, b, c, d] = Array.from(rows.subarray(k, k + 4), value); // the lower two, then the upper two
    yield [
      [left, low, a],
      [right, low, b],
      [right, high, d],
      [left, high, c],
    ];
  }
}
