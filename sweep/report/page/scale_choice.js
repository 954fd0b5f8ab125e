// A selection list for the scale of a column's axes.
import { allowedScales } from "./axes.js";
import { element, fillSelect } from "./dom.js";

/** @import { ScaleKind } from "./axes.js" */
/** @import { Column } from "./data.js" */
/** @import { App } from "./main.js" */

/**
 * Make a selection list for a column's scale; it is hidden for columns that have only one.
 * @type {(app: App, label: string) => { select: HTMLSelectElement, show: (column: Column) => void }}
 */
export function makeScaleChoice(app, label) {
  const select = element("select", { class: "scale", "aria-label": label, title: label });
  /** @type {Column | null} */
  let shown = null;
  const show = (/** @type {Column} */ column) => {
    const kinds = allowedScales(column);
    if (column !== shown)
      fillSelect(
        select,
        kinds.map((kind) => [kind, kind]),
        column.scale,
      );
    select.value = column.scale;
    select.hidden = !kinds.length;
    shown = column;
  };
  select.addEventListener("change", () => shown && app.rescale(shown, /** @type {ScaleKind} */ (select.value)));
  return { select, show };
}
