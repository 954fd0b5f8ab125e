// The page of several policies: a sortable table, and small maps of the same points.
import { clipName, pointId, readTable } from "./data.js";
import { byId, columnOptions, element, fillSelect, makeButton, readTheme } from "./dom.js";
import { formatColumnValue } from "./map.js";
import { makeState } from "./selection.js";
import { sidesView } from "./sides.js";

/** @import { Column } from "./data.js" */
/** @import { App } from "./main.js" */

const MAX_WORDS = 14; // policies, or parameters, that a tip lists

/** @returns {Promise<void>} */
export async function startLeague() {
  const table = await readTable(JSON.parse(byId("data").textContent ?? "{}"));
  document.documentElement.classList.add("live");
  const { sides } = table;
  sortByHeads(/** @type {HTMLTableElement} */ (byId("league")), (names) => {
    // the maps follow the order of the table
    [...byId("sides").children].forEach((map, k) => {
      /** @type {HTMLElement} */ (map).style.order = String(names.indexOf(sides?.names[k] ?? ""));
    });
  });
  const numbers = table.columns.filter((column) => column.axis && !column.names);
  if (!sides || !numbers.length) return;
  const selects = ["map-x", "map-y"].map((id) => /** @type {HTMLSelectElement} */ (byId(id)));
  selects.forEach((select, k) => fillSelect(select, columnOptions(numbers), (numbers[k] ?? numbers[0]).key));
  const state = makeState(table);
  let theme = readTheme();
  /** @type {(row: number, shown: Column[]) => Node[]} */
  const words = (row, shown) => {
    const outcomes = sides.names.map((name, side) => [name, sides.styles[sides.kinds[side][row]].label]);
    const columns = [...new Set([...shown, ...numbers])].slice(0, MAX_WORDS);
    const values = columns.map((column) => [column.label, formatColumnValue(column, column.values[row])]);
    const lines = [...outcomes.slice(0, MAX_WORDS), ...values];
    const parts = lines.flatMap(([name, text]) => [element("dt", {}, clipName(name)), element("dd", {}, text)]);
    return [element("dl", {}, ...parts), element("span", { class: "soft" }, pointId(table, row))];
  };
  const app = /** @type {App} */ (
    /** @type {unknown} */ ({
      table,
      state,
      theme: () => theme,
      words,
      point: (/** @type {number} */ row) => {
        state.cursor = row;
        view.point?.();
      },
      choose: (/** @type {number} */ row) => {
        state.chosen = row === state.chosen ? -1 : row;
        view.point?.();
      },
    })
  );
  const view = sidesView(app, sides);
  view.draw();
  for (const select of selects) select.addEventListener("change", () => view.draw());
  const again = () => {
    theme = readTheme();
    view.draw();
  };
  window.addEventListener("resize", again);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
}

/**
 * Let the headings of a table sort its lines by the values in `data-value`; `sorted` receives the names of the lines.
 * @type {(table: HTMLTableElement, sorted: (names: string[]) => void) => void}
 */
function sortByHeads(table, sorted) {
  const body = table.tBodies[0];
  const heads = [...table.querySelectorAll("thead th")];
  heads.forEach((head, k) => {
    const value = (/** @type {HTMLTableRowElement} */ line) => line.cells[k].dataset.value ?? "";
    const isNumber = [...body.rows].every((line) => Number.isFinite(Number(value(line))));
    const sort = () => {
      const way = head.getAttribute("aria-sort") === (isNumber ? "descending" : "ascending") ? 1 : -1;
      const up = isNumber ? way : -way;
      const lines = [...body.rows].sort((a, b) =>
        isNumber ? up * (Number(value(a)) - Number(value(b))) : up * value(a).localeCompare(value(b)),
      );
      for (const other of heads) other.setAttribute("aria-sort", "none");
      head.setAttribute("aria-sort", up > 0 ? "ascending" : "descending");
      body.replaceChildren(...lines);
      sorted(lines.map((line) => line.cells[0].dataset.value ?? ""));
    };
    head.replaceChildren(makeButton({ class: "sort" }, sort, head.textContent ?? ""));
  });
}
