"use strict";
/* What scripts add to any page: tables sorted by a click on their heads, a word above what is wider
   than the screen, links that open folded parts, and where the reader is in the contents. */
(() => {
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];

  /* ---- tables, sorted by their heads ------------------------------------------------------- */

  const numberOf = (words) =>
    parseFloat(words.replaceAll(",", "").replaceAll("−", "-").replaceAll("∞", "Infinity"));
  // The headline of a cell, without the small figures below it.
  const wordsOf = (cell) =>
    ([...cell.querySelectorAll("span")].find((span) => span.offsetParent) || cell).textContent.trim();

  function sorted(rows, column, falling) {
    const cells = rows.map((row) => wordsOf(row.cells[column]));
    const known = cells.filter((words) => words !== "" && words !== "–");
    const numeric = known.length > 0 && known.every((words) => !Number.isNaN(numberOf(words)));
    const sign = falling ? -1 : 1;
    return rows.map((row, i) => [row, cells[i]]).sort(([, a], [, b]) => {
      const missing = [a, b].map((words) => !known.includes(words));
      if (missing[0] || missing[1]) return missing[0] - missing[1];
      if (numeric) return sign * (numberOf(a) - numberOf(b)) || 0;
      return sign * a.localeCompare(b, "en", {numeric: true});
    }).map(([row]) => row);
  }

  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    // What algorithms are measured against stays below them.
    const rows = [...body.rows].filter((row) => !row.cells[0].querySelector("em"));
    if (rows.length < 2) return;
    const last = [...body.rows].filter((row) => !rows.includes(row));
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const falling = head.ariaSort === "ascending";
        heads.forEach((one) => one.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", falling ? "descending" : "ascending");
        body.append(...sorted(rows, column, falling), ...last);
      });
    });
  }

  all(".scroll > table").forEach(sortable);

  /* ---- what is wider than the screen -------------------------------------------------------- */

  const sizes = new ResizeObserver((entries) => entries.forEach(({target}) =>
    target.classList.toggle("overflows", target.scrollWidth > target.clientWidth + 1)));
  all(".scroll").forEach((box) => sizes.observe(box));

  /* ---- links into folded parts -------------------------------------------------------------- */

  function open(hash) {
    const target = hash.length > 1 && document.getElementById(decodeURIComponent(hash.slice(1)));
    const folded = target && target.querySelector(":scope > details");
    if (folded) folded.open = true;
  }

  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    if (link) open(link.hash);
  });
  open(location.hash);

  /* ---- where the reader is ------------------------------------------------------------------ */

  const contents = document.querySelector("nav");
  if (!contents) return;
  const link = (section) => contents.querySelector(`[href="#${CSS.escape(section.id)}"]`);
  const seen = new IntersectionObserver((entries) => entries.forEach(({target, isIntersecting}) => {
    if (!isIntersecting || !link(target)) return;
    all("[aria-current]", contents).forEach((one) => one.removeAttribute("aria-current"));
    const here = link(target);
    here.setAttribute("aria-current", "true");
    contents.scrollLeft = here.offsetLeft - (contents.clientWidth - here.offsetWidth) / 2;
  }), {rootMargin: "-20% 0px -79% 0px"});
  all("main > section").forEach((section) => seen.observe(section));
})();
