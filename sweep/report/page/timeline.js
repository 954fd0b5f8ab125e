// Timeline below a replay: stages, pushes, time of the cause, and the present time.
import { clipName } from "./data.js";
import { prepareCanvas } from "./dom.js";
import { stageSpans } from "./kinematics.js";

/** @import { App } from "./main.js" */
/** @import { Reel } from "./player.js" */

/**
 * Draw the stages along time, a triangle where a push begins, and the time of the cause.
 * @param {App} app
 * @param {HTMLCanvasElement} canvas
 * @param {Reel} reel
 * @param {number} time s
 * @param {number} total s
 */
export function drawStages(app, canvas, reel, time, total) {
  const { table } = app;
  const { replays } = table.about;
  const { pen, width, height } = prepareCanvas(canvas);
  const { ink, soft, line, accent } = app.theme();
  const xOf = (/** @type {number} */ at) => (at / total) * width;
  pen.textBaseline = "middle";
  pen.textAlign = "left";
  for (const { stage, from, to } of stageSpans(reel.motion)) {
    const [left, right] = [xOf(from), xOf(to)];
    const now = time > from && time <= to + 1e-9;
    pen.globalAlpha = now ? 0.45 : stage % 2 ? 0.42 : 0.2;
    pen.fillStyle = now ? accent : line;
    pen.fillRect(left, 0, right - left - 1, height);
    pen.globalAlpha = 1;
    const name = clipName(replays[reel.number].stages[stage] ?? "");
    pen.fillStyle = now ? ink : soft;
    if (pen.measureText(name).width < right - left - 8) pen.fillText(name, left + 4, height / 2);
  }
  const row = replays[reel.number].row;
  const kind = table.about.kinds.find(({ key }) => key === replays[reel.number].kind);
  const cause = table.named.get("t_cause_s")?.values[row];
  if (cause !== undefined && Number.isFinite(cause)) {
    pen.fillStyle = kind?.colour ?? table.about.colours.failure;
    pen.fillRect(xOf(cause) - 1.5, 0, 3, height);
  }
  pen.fillStyle = soft;
  for (const { start } of reel.motion.pushes) {
    pen.beginPath();
    pen.moveTo(xOf(start), height / 2);
    pen.lineTo(xOf(start) - 4, 0);
    pen.lineTo(xOf(start) + 4, 0);
    pen.fill();
  }
  pen.fillStyle = ink;
  pen.fillRect(xOf(time) - 1, 0, 2, height);
}
