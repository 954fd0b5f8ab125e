// What a reader takes away: pictures of views, the chosen rows as a table, a replay as a video.
import { pointOf } from "./data.js";
import { element } from "./dom.js";

/** @typedef {import("./main.js").App} App */

/**
 * Give the reader a file.
 * @param {Blob} content
 * @param {string} name
 */
export function give(content, name) {
  const address = URL.createObjectURL(content);
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/**
 * The rows that pass the filters as CSV, a column for each that the page holds.
 * @param {App} app
 * @returns {string}
 */
export function csvOf({ table, state }) {
  const { kinds, stages } = table.about;
  const quoted = (/** @type {string} */ text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const lines = [["point_id", "outcome", "cause", "stage", ...table.columns.map(({ key }) => quoted(key))].join()];
  for (let row = 0; row < table.rows; row++) {
    if (!state.mask[row]) continue;
    const { key, outcome } = kinds[table.kind[row]];
    const stage = table.stage[row] ? stages[table.stage[row] - 1] : "";
    const values = table.columns.map(({ names, values }) => {
      const value = values[row];
      return Number.isNaN(value) ? "" : names ? quoted(names[value]) : String(Number(value.toPrecision(6)));
    });
    lines.push([pointOf(table, row), outcome, outcome === "success" ? "" : key, quoted(stage), ...values].join());
  }
  return `${lines.join("\n")}\n`;
}

/**
 * Canvases that lie over each other as one picture on the panel's ground.
 * @param {HTMLCanvasElement[]} layers
 * @param {string} ground
 * @returns {Promise<Blob | null>}
 */
export function pictureOf(layers, ground) {
  const [{ width, height }] = layers;
  const whole = element("canvas", { width: String(width), height: String(height) });
  const pen = /** @type {CanvasRenderingContext2D} */ (whole.getContext("2d"));
  pen.fillStyle = ground;
  pen.fillRect(0, 0, width, height);
  for (const layer of layers) if (layer.width) pen.drawImage(layer, 0, 0);
  return new Promise((done) => whole.toBlob(done));
}

/**
 * A button below each chart that saves it.
 * @param {App} app
 */
export function offerPictures(app) {
  for (const panel of document.querySelectorAll("#explore .panel")) {
    const canvases = () => [
      .../** @type {NodeListOf<HTMLCanvasElement>} */ (panel.querySelectorAll(".plot canvas, canvas.chart")),
    ];
    const [first] = canvases();
    if (!first) continue;
    const button = element("button", { type: "button", class: "save", title: "save as a picture" }, "PNG");
    button.addEventListener("click", async () => {
      const layers = first.closest(".plot") ? canvases().filter((one) => one.closest(".plot")) : [first];
      const picture = await pictureOf(layers, app.theme().panel);
      if (picture) give(picture, `${panel.querySelector("h2")?.textContent ?? "view"}.png`);
    });
    panel.querySelector("h2")?.append(" ", button);
  }
}

/**
 * What a canvas shows from now on, as WebM, until it is stopped.
 * @param {HTMLCanvasElement} canvas
 * @returns {{ stop: () => void }}
 */
export function recorded(canvas) {
  const parts = /** @type {Blob[]} */ ([]);
  const recorder = new MediaRecorder(canvas.captureStream(30), { mimeType: "video/webm", videoBitsPerSecond: 6e6 });
  recorder.addEventListener("dataavailable", ({ data }) => parts.push(data));
  recorder.addEventListener("stop", () => give(new Blob(parts, { type: "video/webm" }), "replay.webm"));
  recorder.start();
  return recorder;
}
