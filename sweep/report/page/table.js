// The rows as a sortable table, page by page, each with a link to its replay.
import { pointId } from "./data.js";
import { makeButton, byId, element } from "./dom.js";
import { formatCount, formatShort } from "./numbers.js";

/** @import { Column } from "./data.js" */
/** @import { App, View } from "./main.js" */

const PAGE_ROWS = 20;
const MAX_COLUMNS = 10; // columns of numbers

/** @type {(app: App) => View} */
export function rowsTableView(app) {
  const { table, state } = app;
  const root = byId("list");
  const columns = [
    ...table.columns.filter((column) => column.axis),
    ...table.columns.filter((column) => !column.axis),
  ].slice(0, MAX_COLUMNS);
  const { kinds, stages } = table.about;
  let first = 0;
  let sorted = -1;
  let falling = false;
  let before = state.passing;

  const heads = columns.map((column, k) => {
    const sort = () => {
      falling = sorted === k && !falling;
      sorted = k;
      first = 0;
      app.redraw();
    };
    const button = makeButton({ class: "sort", title: column.path }, sort, column.title);
    return element("th", { scope: "col", "aria-sort": "none" }, button);
  });
  const body = element("tbody");
  const words = ["replay", "outcome", "stage"].map((text) => element("th", { scope: "col" }, text));
  root.replaceChildren(
    element("table", { class: "rows" }, element("thead", {}, element("tr", {}, ...words, ...heads)), body),
  );
  const pages = byId("list-pages");
  const turn = (/** @type {number} */ by) => () => {
    first = Math.max(0, first + by * PAGE_ROWS);
    app.redraw();
  };
  const [back, on] = [makeButton({}, turn(-1), "Previous"), makeButton({}, turn(1), "Next")];
  const where = element("span", { class: "soft" });
  pages.replaceChildren(back, where, on);

  const draw = () => {
    if (before !== state.passing) first = 0;
    before = state.passing;
    const order = sorted < 0 ? null : app.order(columns[sorted]);
    const rows = [];
    const count = order ? order.length : table.rows;
    let at = -1;
    for (let k = 0; k < count && rows.length < PAGE_ROWS; k++) {
      const row = order ? order[falling ? count - 1 - k : k] : k;
      if (state.mask[row] && ++at >= first) rows.push(row);
    }
    heads.forEach((head, k) =>
      head.setAttribute("aria-sort", k !== sorted ? "none" : falling ? "descending" : "ascending"),
    );
    body.replaceChildren(
      ...rows.map((row) => {
        const own = table.replayed.has(row);
        const point = pointId(table, row);
        const label = `show ${own ? "the replay" : "a replay near"} ${point}`;
        const button = makeButton({ "aria-label": label }, () => app.choose(row), own ? "▶" : "▷");
        const numbers = columns.map(({ names, values }) =>
          names ? (names[values[row]] ?? "") : formatShort(values[row]),
        );
        const stage = table.stage[row] ? (stages[table.stage[row] - 1] ?? "") : "";
        const cells = [button, kinds[table.kind[row]].label, stage, ...numbers];
        const line = element("tr", {}, ...cells.map((cell) => element("td", {}, cell)));
        if (row === state.chosen) line.setAttribute("aria-current", "true");
        return line;
      }),
    );
    where.textContent = state.passing
      ? ` ${formatCount(first + 1)} to ${formatCount(first + rows.length)} of ${formatCount(state.passing)} `
      : " no row passes the filters ";
    back.disabled = first === 0;
    on.disabled = first + PAGE_ROWS >= state.passing;
  };
  return { root, draw };
}
