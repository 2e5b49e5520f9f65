"use strict";
(() => {
  // Rows of explanation stay with the row above them.
  const groups = (body) => [...body.rows].reduce((all, row) => {
    if (row.classList.contains("why") && all.length) all.at(-1).push(row);
    else all.push([row]);
    return all;
  }, []);
  for (const table of document.querySelectorAll("table.sortable")) {
    // Several tables have two lines of heading; the first line's cells stand over the columns one by one.
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const key = ([row]) => {
          const text = (row.cells[column]?.textContent ?? "").trim();
          const number = parseFloat(text.replace(/^[^\d\u2212-]+/, "").replace("\u2212", "-").replace(/(\d)\u202f(?=\d)/g, "$1"));
          return column === 0 ? text : Number.isNaN(number) ? text : number;
        };
        const order = (x, y) => {
          // Numbers before words, either way up; words by the alphabet, design numbers by their size.
          if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1;
          const up = typeof x === "string" ? x.localeCompare(y, "en", { numeric: true }) : x - y;
          return down ? -up : up;
        };
        const sorted = groups(table.tBodies[0]).sort((a, b) => order(key(a), key(b)));
        table.tBodies[0].append(...sorted.flat());
      });
    });
  }
})();
