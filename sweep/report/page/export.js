// Exports: pictures of views, the filtered rows as CSV, a replay as a video.
import { pointId } from "./data.js";
import { drawLegendSymbol, LEGEND_SYMBOL } from "./charts.js";
import { byId, makeButton, element, recorders, resolution, shortenToFit, wrapToFit } from "./dom.js";
import { formatCount } from "./numbers.js";
import { VectorPen } from "./vector.js";

/** @import { App } from "./main.js" */

/**
 * What stands above a saved picture: the study and the view, the selection, and the legend of kinds.
 * @typedef {object} Head
 * @property {string} title
 * @property {string[]} setup lines: scenario, robot, engine, design and number of rollouts
 * @property {string} selection
 * @property {{ kind: number, text: string, x: number, y: number }[]} entries
 * @property {number} height CSS pixels
 */

const PICTURE_RATIO = 2; // pixels of a PNG picture for each CSS pixel
const HEAD_FONTS = ["bold 14px sans-serif", "12px sans-serif"]; // of the title, and of what follows
const [HEAD_TOP, HEAD_LINE] = [6, 18]; // CSS pixels above the title, and from line to line
const LEGENDED = "#curves, #estimate-chart, #map-base, #lines-base, #stages"; // views whose colours are those of kinds

/**
 * Let the user download a file.
 * @type {(content: Blob, name: string) => void}
 */
export function download(content, name) {
  const address = URL.createObjectURL(content);
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/**
 * Format the rows that pass the filters as CSV, with all columns of the page.
 * @type {(app: App) => string}
 */
export function formatCsv({ table, state }) {
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
    lines.push([pointId(table, row), outcome, outcome === "success" ? "" : key, quoted(stage), ...values].join());
  }
  return `${lines.join("\n")}\n`;
}

/**
 * Canvases on which a panel draws, and their boxes, without those in explanations or buttons.
 * @type {(panel: Element) => { canvases: HTMLCanvasElement[], boxes: DOMRect[], whole: DOMRect }}
 */
function panelCanvases(panel) {
  const canvases = [.../** @type {NodeListOf<HTMLCanvasElement>} */ (panel.querySelectorAll("canvas"))].filter(
    (one) => one.checkVisibility() && !one.closest("p, button"),
  );
  const boxes = canvases.map((one) => one.getBoundingClientRect());
  const [left, top] = [Math.min(...boxes.map((box) => box.left)), Math.min(...boxes.map((box) => box.top))];
  const [right, bottom] = [Math.max(...boxes.map((box) => box.right)), Math.max(...boxes.map((box) => box.bottom))];
  return { canvases, boxes, whole: new DOMRect(left, top, right - left, bottom - top) };
}

/**
 * Lay out what stands above the picture of a panel.
 * @type {(app: App, panel: Element, name: string, width: number) => Head}
 */
function layHead({ table, state }, panel, name, width) {
  const pen = /** @type {CanvasRenderingContext2D} */ (element("canvas").getContext("2d"));
  pen.font = HEAD_FONTS[0];
  const title = shortenToFit(pen, `${table.about.name}: ${name}`, width - 16);
  pen.font = HEAD_FONTS[1];
  const setup = wrapToFit(pen, table.about.setup ?? "", width - 16); // pages of earlier versions have none
  const top = HEAD_TOP + HEAD_LINE * (1 + setup.length); // of the selection
  const filters = [...byId("filters").children].map((one) => (one.textContent ?? "").replace(/ ×$/, ""));
  const selection = shortenToFit(pen, [byId("passing").textContent, ...filters].join("; "), width - 16);
  const counts = new Int32Array(table.about.kinds.length);
  for (let row = 0; row < table.rows; row++) counts[table.kind[row]] += state.mask[row];
  let [x, y] = [8, top + HEAD_LINE];
  /** @type {Head["entries"]} */
  const entries = [];
  table.about.kinds.forEach(({ label }, kind) => {
    if (!counts[kind] || !panel.querySelector(LEGENDED)) return;
    const text = `${label} ${formatCount(counts[kind])}`;
    const room = LEGEND_SYMBOL + 5 + pen.measureText(text).width;
    if (x > 8 && x + room > width) [x, y] = [8, y + 19];
    entries.push({ kind, text, x, y });
    x += room + 16;
  });
  return { title, setup, selection, entries, height: (entries.length ? y : top) + 23 };
}

/** @type {(app: App, head: Head, pen: CanvasRenderingContext2D, ratio: number) => void} */
function drawHead(app, { title, setup, selection, entries }, pen, ratio) {
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.textBaseline = "top";
  pen.textAlign = "left";
  [pen.fillStyle, pen.font] = [app.theme().ink, HEAD_FONTS[0]];
  pen.fillText(title, 8, HEAD_TOP);
  [pen.fillStyle, pen.font] = [app.theme().soft, HEAD_FONTS[1]];
  [...setup, selection].forEach((text, k) => pen.fillText(text, 8, HEAD_TOP + HEAD_LINE * (k + 1)));
  for (const { kind, text, x, y } of entries) {
    drawLegendSymbol(app, pen, x, y, kind, ratio);
    pen.fillStyle = app.theme().ink;
    pen.fillText(text, x + LEGEND_SYMBOL + 5, y);
  }
}

/**
 * Compose a panel's canvases into one PNG picture of twice the screen's size, below its title and legend.
 * @type {(app: App, panel: Element, name: string) => Promise<Blob | null>}
 */
async function panelPng(app, panel, name) {
  resolution.ratio = PICTURE_RATIO;
  await app.drawn();
  const { canvases, boxes, whole } = panelCanvases(panel);
  const head = layHead(app, panel, name, whole.width);
  const size = { width: `${PICTURE_RATIO * whole.width}`, height: `${PICTURE_RATIO * (head.height + whole.height)}` };
  const paper = element("canvas", size);
  const pen = /** @type {CanvasRenderingContext2D} */ (paper.getContext("2d"));
  pen.fillStyle = app.theme().panel;
  pen.fillRect(0, 0, paper.width, paper.height);
  drawHead(app, head, pen, PICTURE_RATIO);
  canvases.forEach((one, k) => {
    const { left, top, width, height } = boxes[k];
    if (one.width) pen.drawImage(one, left - whole.left, head.height + top - whole.top, width, height);
  });
  resolution.ratio = 0;
  await app.drawn();
  return new Promise((done) => paper.toBlob(done));
}

/**
 * Compose a panel's canvases into one SVG drawing: all are vectors, but for maps of very many cells or marks.
 * @type {(app: App, panel: Element, name: string) => Promise<Blob>}
 */
async function panelSvg(app, panel, name) {
  const { canvases, boxes, whole } = panelCanvases(panel);
  const pens = canvases.map((one) => new VectorPen(one));
  canvases.forEach((one, k) => recorders.set(one, pens[k]));
  await app.drawn().finally(() => recorders.clear());
  const head = layHead(app, panel, name, whole.width);
  const pen = new VectorPen(element("canvas"));
  drawHead(app, head, /** @type {CanvasRenderingContext2D} */ (/** @type {unknown} */ (pen)), PICTURE_RATIO);
  const parts = boxes.map(({ left, top, width, height }, k) => {
    const place = `x="${left - whole.left}" y="${head.height + top - whole.top}" width="${width}" height="${height}"`;
    return `<svg ${place}>${pens[k].text()}</svg>`;
  });
  const ground = `<rect width="100%" height="100%" fill="${app.theme().panel}"/>`;
  const text = `<svg xmlns="http://www.w3.org/2000/svg" width="${whole.width}" height="${head.height + whole.height}" data-head="${head.height}">${ground}`;
  return new Blob([text, pen.text(), ...parts, "</svg>"], { type: "image/svg+xml" });
}

/**
 * Add buttons that save the pictures of each panel.
 * @param {App} app
 */
export function offerPictures(app) {
  for (const panel of document.querySelectorAll("#explore .panel")) {
    const head = panel.querySelector("h2, details > p");
    const name = panel.querySelector("h2, summary")?.textContent ?? "view";
    for (const [word, made] of /** @type {const} */ ([
      ["PNG", panelPng],
      ["SVG", panelSvg],
    ])) {
      const save = async () => {
        if (!panelCanvases(panel).canvases.length) return;
        const content = await made(app, panel, name);
        if (content) download(content, `${name}.${word.toLowerCase()}`);
      };
      const button = makeButton({ class: "save", title: `save "${name}" as ${word}` }, save, word);
      if (!panel.querySelector("#list")) head?.append(" ", button);
    }
  }
}

/**
 * Record the visible canvases side by side as a WebM video until it is stopped.
 * @param {HTMLCanvasElement[]} canvases
 * @param {string} ground colour behind them
 * @returns {{ stop: () => void, taken: () => void }} `taken` is called after each frame is drawn
 */
export function recordVideo(canvases, ground) {
  const parts = /** @type {Blob[]} */ ([]);
  const seen = canvases.filter((one) => one.clientHeight);
  const width = seen.reduce((sum, one) => sum + one.width, 0);
  const height = Math.max(...seen.map((one) => one.height));
  const paper = element("canvas", { width: `${width}`, height: `${height}` });
  const pen = /** @type {CanvasRenderingContext2D} */ (paper.getContext("2d"));
  const taken = () => {
    pen.fillStyle = ground;
    pen.fillRect(0, 0, width, height);
    seen.reduce((left, one) => (pen.drawImage(one, left, 0), left + one.width), 0);
  };
  taken();
  const recorder = new MediaRecorder(paper.captureStream(30), { mimeType: "video/webm", videoBitsPerSecond: 6e6 });
  recorder.addEventListener("dataavailable", ({ data }) => parts.push(data));
  recorder.addEventListener("stop", () => download(new Blob(parts, { type: "video/webm" }), "replay.webm"));
  recorder.start();
  return { stop: () => recorder.stop(), taken };
}
