// The probability of failure that a search estimated, with its interval, and the modes in which rollouts fail.
import { makeScale } from "./axes.js";
import { drawKindBox } from "./charts.js";
import { byId, cssColour, drawLine, element, placeTip, pointerPosition, prepareCanvas } from "./dom.js";
import { clamp, formatCount, formatShort } from "./numbers.js";
import { setRange } from "./selection.js";

/** @import { Scale } from "./axes.js" */
/** @import { Estimate, Mode } from "./data.js" */
/** @import { App, View } from "./main.js" */

const ESTIMATE_MARGIN = { left: 12, right: 12 };
const [INTERVAL_HEIGHT, MODE_HEIGHT, BAR_HEIGHT] = [104, 68, 22]; // CSS pixels
const INTERVAL_LINE = 44; // CSS pixels from the top to the interval
const AXIS_ROOM = 3; // factor by which the axis reaches beyond the interval, at least
const MODE_COLUMN = "failure mode";

/**
 * The estimate above its modes; click a mode to select its rows and open a replay.
 * @type {(app: App) => View}
 */
export function estimateView(app) {
  const { table, state } = app;
  const canvas = /** @type {HTMLCanvasElement} */ (byId("estimate-chart"));
  const tip = byId("estimate-tip");
  const estimate = /** @type {Estimate} */ (table.about.estimate);
  const { modes } = estimate;
  const column = table.named.get(MODE_COLUMN);
  const kinds = new Map(table.about.kinds.map(({ key }, k) => [key, k]));
  canvas.style.height = `${INTERVAL_HEIGHT + MODE_HEIGHT * Math.max(1, modes.length)}px`;

  /**
   * Number of the mode at a height, -1 for none.
   * @type {(y: number) => number}
   */
  const modeAt = (y) => {
    const mode = Math.floor((y - INTERVAL_HEIGHT) / MODE_HEIGHT);
    return mode < modes.length ? Math.max(-1, mode) : -1;
  };
  const isChosen = (/** @type {number} */ mode) => state.ranges.get(MODE_COLUMN)?.low === mode;

  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = pointerPosition(event, canvas);
    const mode = modeAt(y);
    canvas.style.cursor = mode < 0 ? "" : "pointer";
    tip.hidden = mode < 0;
    if (mode < 0) return;
    tip.replaceChildren(...describeMode(modes[mode]));
    placeTip(tip, x, y);
  });
  canvas.addEventListener("pointerleave", () => (tip.hidden = true));
  canvas.addEventListener("click", (event) => {
    const mode = modeAt(pointerPosition(event, canvas)[1]);
    if (mode < 0 || !column) return;
    const chosen = isChosen(mode);
    setRange(state, MODE_COLUMN, chosen ? null : { low: mode, high: mode });
    app.filtered();
    if (chosen) return;
    const rows = Array.from(column.values.keys()).filter((row) => column.values[row] === mode);
    const row = rows.find((one) => table.replayed.has(one)) ?? rows[0];
    if (row !== undefined) app.choose(row);
  });

  const draw = () => {
    const { pen, width, ratio } = prepareCanvas(canvas);
    const theme = app.theme();
    const { left, right } = ESTIMATE_MARGIN;
    const room = width - left - right;
    drawInterval(app, pen, estimate, left, room);
    const looks = app.looks();
    modes.forEach((mode, number) => {
      const top = INTERVAL_HEIGHT + number * MODE_HEIGHT;
      pen.globalAlpha = state.ranges.has(MODE_COLUMN) && !isChosen(number) ? 0.4 : 1;
      pen.textBaseline = "top";
      pen.textAlign = "left";
      pen.fillStyle = theme.ink;
      pen.fillText(`mode ${mode.label}`, left, top, room * 0.6);
      pen.textAlign = "right";
      pen.fillText(`${formatShare(mode.share)} of P(failure)`, left + room, top, room * 0.4);
      pen.fillStyle = cssColour(theme.paper);
      pen.strokeStyle = theme.line;
      pen.strokeRect(left + 0.5, top + 18.5, room - 1, BAR_HEIGHT - 1);
      let x = left;
      for (const { kind, share } of mode.causes) {
        const size = share * mode.share * room;
        const look = looks[kinds.get(kind) ?? -1];
        if (look) drawKindBox(pen, x, top + 18, Math.max(1, size), BAR_HEIGHT, look, ratio);
        x += size;
      }
      pen.textAlign = "left";
      pen.fillStyle = theme.soft;
      const where = `${mode.place.replaceAll("-", "−")} standard deviations; ${formatCount(mode.rows)} rollouts`;
      pen.fillText(where, left, top + 18 + BAR_HEIGHT + 4, room);
      pen.globalAlpha = 1;
    });
    if (!modes.length) {
      pen.fillStyle = theme.soft;
      pen.textAlign = "left";
      pen.textBaseline = "top";
      pen.fillText("No failure was found.", left, INTERVAL_HEIGHT);
    }
  };
  return { root: canvas, draw };
}

/**
 * Draw the estimate with its interval along a logarithmic axis.
 * @param {App} app
 * @param {CanvasRenderingContext2D} pen
 * @param {Estimate} estimate
 * @param {number} left
 * @param {number} room
 */
function drawInterval(app, pen, { probability, low, high, reliable }, left, room) {
  const { ink, soft, line, accent } = app.theme();
  const known = [probability, low, high].filter((one) => one !== null && one > 0);
  const scale = probabilityScale(/** @type {number[]} */ (known), room / 80);
  const at = (/** @type {number} */ value) => left + clamp(scale.to(value), 0, 1) * room;
  const bottom = INTERVAL_LINE + 18;
  pen.strokeStyle = line;
  pen.lineWidth = 1;
  drawLine(pen, left, bottom + 0.5, left + room, bottom + 0.5);
  pen.fillStyle = soft;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  for (const { value } of scale.ticks) {
    drawLine(pen, at(value), bottom, at(value), bottom + 4);
    pen.fillText(formatShort(value), clamp(at(value), left + 12, left + room - 12), bottom + 6);
  }
  pen.fillText("probability of failure of a rollout (log)", left + room / 2, bottom + 22, room);
  pen.strokeStyle = accent;
  pen.fillStyle = accent;
  pen.lineWidth = 4;
  const ends = [low && low > 0 ? low : probability ? null : 0, high];
  const [from, to] = ends.map((end) => (end === null ? NaN : end ? at(end) : left));
  if (!reliable) pen.setLineDash([6, 4]);
  if (to > from) drawLine(pen, from, INTERVAL_LINE, to, INTERVAL_LINE);
  pen.setLineDash([]);
  pen.textBaseline = "bottom";
  pen.fillStyle = ink;
  const caution = reliable ? "" : ", not reliable";
  if (probability) {
    pen.fillStyle = accent;
    pen.beginPath();
    pen.arc(at(probability), INTERVAL_LINE, 7, 0, 2 * Math.PI);
    pen.fill();
    pen.fillStyle = ink;
    const text = `${formatShort(Number(probability.toPrecision(3)))}${caution}`;
    pen.fillText(text, clamp(at(probability), left + 60, left + room - 60), INTERVAL_LINE - 12, room);
  } else if (high) {
    const text = `at most ${formatShort(Number(high.toPrecision(2)))}${caution}`;
    pen.fillText(text, clamp(to, left + 70, left + room - 70), INTERVAL_LINE - 12, room);
  }
}

/**
 * Logarithmic scale of probabilities up to 1 that has room beyond the known ones.
 * @type {(known: number[], room: number) => Scale}
 */
function probabilityScale(known, room) {
  const [least, most] = known.length ? [Math.min(...known), Math.max(...known)] : [1e-3, 1];
  const low = 10 ** Math.floor(Math.log10(least / AXIS_ROOM));
  const high = Math.min(1, 10 ** Math.ceil(Math.log10(most * AXIS_ROOM)));
  return makeScale({ low, high, scale: "log", linear: 1, names: null }, null, room);
}

/** @type {(share: number) => string} */
function formatShare(share) {
  return `${Number((100 * share).toPrecision(share < 0.1 ? 2 : 3))} %`;
}

/** @type {(mode: Mode) => Node[]} */
function describeMode({ label, share, rows, place, causes }) {
  const lines = causes.flatMap(({ kind, share }) => [
    element("dt", {}, kind.replaceAll("_", " ")),
    element("dd", {}, formatShare(share)),
  ]);
  const told = `${formatShare(share)} of P(failure), ${formatCount(rows)} rollouts`;
  return [
    element("strong", {}, `mode ${label}`),
    element("div", {}, told),
    element("dl", {}, ...lines),
    element("span", { class: "soft" }, `at ${place.replaceAll("-", "−")} standard deviations`),
  ];
}
