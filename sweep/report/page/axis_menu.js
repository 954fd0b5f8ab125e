// The menu of the parallel coordinates: which columns have an axis, found by name, inverted or not, and on which scale.
import { clipName } from "./data.js";
import { element, makeButton } from "./dom.js";
import { makeScaleChoice } from "./scale_choice.js";

/** @import { Column } from "./data.js" */
/** @import { App } from "./main.js" */
/** @import { LineAxis } from "./selection.js" */

/**
 * Make the menu.
 * @param {App} app
 * @param {(axes: LineAxis[]) => void} arrange takes the axes that the reader chose
 * @returns {{ root: HTMLElement, show: (axes: LineAxis[], fitting: number) => void }} `show` is told the axes, and how
 * many of them fit
 */
export function makeAxisMenu(app, arrange) {
  /** @type {LineAxis[]} */
  let axes = [];
  const summary = element("summary");
  const find = element("input", { type: "search", placeholder: "find a column", "aria-label": "find a column" });
  const list = element("ul");
  const lines = app.table.columns.map((column) => {
    const box = element("input", { type: "checkbox" });
    const scale = makeScaleChoice(app, `scale of ${column.label}`);
    const axis = () => axes.find((one) => one.column === column);
    const invert = () => arrange(axes.map((one) => (one === axis() ? { column, inverted: !one.inverted } : one)));
    const button = makeButton({ "aria-pressed": "false" }, invert, "inverted");
    box.addEventListener("change", () => {
      const rest = axes.filter((one) => one.column !== column);
      arrange(box.checked ? [...rest, { column, inverted: false }] : rest);
    });
    const root = element("li", {}, element("label", {}, box, clipName(column.title)), button, scale.select);
    const show = () => {
      const own = axis();
      [box.checked, box.disabled] = [!!own, !!own && axes.length <= 2];
      button.hidden = !own;
      button.setAttribute("aria-pressed", String(!!own?.inverted));
      scale.show(column);
    };
    return { root, show, words: `${column.title} ${column.path} ${column.key}`.toLowerCase() };
  });
  list.append(...lines.map(({ root }) => root));
  find.addEventListener("input", () => {
    for (const { root, words } of lines) root.hidden = !words.includes(find.value.trim().toLowerCase());
  });
  const root = element("details", { class: "axis-menu" }, summary, find, list);
  root.addEventListener("toggle", () => root.open && lines.forEach(({ show }) => show()));
  const show = (/** @type {LineAxis[]} */ now, /** @type {number} */ fitting) => {
    axes = now;
    const narrow = fitting < axes.length ? `, of which ${fitting} fit here` : "";
    summary.textContent = `choose axes (${axes.length} of ${lines.length}${narrow})`;
    if (root.open) lines.forEach(({ show }) => show());
  };
  return { root, show };
}
