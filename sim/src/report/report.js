
// Headers become buttons that sort; without this script the tables read just as well.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const value = (row, i) => {
    const cell = row.cells[i];
    return cell.dataset.v !== undefined ? Number(cell.dataset.v) : cell.className === "none" ? null : cell.textContent;
  };
  const order = (a, b) =>
    typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  table.parentElement.previousElementSibling.append(" A click on a header sorts.");
  heads.forEach((head, i) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.onclick = () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...body.rows].sort((ra, rb) => {
        const a = value(ra, i), b = value(rb, i);
        // What has no value stays last either way.
        return a === null || b === null ? (a === null) - (b === null) : up ? order(a, b) : order(b, a);
      });
      body.append(...rows);
    };
  });
}
