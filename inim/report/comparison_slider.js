"use strict";
/* Comparison slider: drives the elements of #slider with the page's own images, found by
   their content (`data-shows`) and viewpoint (`data-viewpoint`). A missing image is not offered;
   with fewer than two, #slider stays hidden. */
(() => {
  const root = document.getElementById("slider");
  if (!root) return;
  const one = (selector) => root.querySelector(selector);
  const FLIP_MS = 700;  // slower than three a second, which is where flashes may harm

  const sources = new Map();  // by viewpoint, by what is shown
  document.querySelectorAll("img[data-shows]").forEach(({dataset, src}) => {
    if (!sources.has(dataset.viewpoint)) sources.set(dataset.viewpoint, new Map());
    sources.get(dataset.viewpoint).set(dataset.shows, src);
  });
  const choices = {
    viewpoint: one("[name=viewpoint]"), first: one("[name=first]"), second: one("[name=second]"),
  };
  const sides = ["first", "second"];
  const stage = one(".stage"), border = one("[name=border]"), spoken = one(".spoken");
  const flip = one("[name=flip]"), byItself = one("[name=by-itself]");
  const images = sides.map((side) => {
    const image = new Image();
    Object.assign(image, {className: side, alt: "", draggable: false});  // the stage says it
    one(".pictures").append(image);
    return image;
  });
  const labels = sides.map((side) => one(`b.${side}`));
  const way = () => one("[name=compare-by]:checked").value;
  let flipped = false, timer = 0;

  const here = () => sources.get(choices.viewpoint.value) || new Map();

  // What there is a picture of from this viewpoint.
  function offer() {
    sides.forEach((side) => [...choices[side].options].forEach((option) => {
      option.disabled = !here().has(option.value);
    }));
    sides.forEach((side) => {
      const {options, selectedIndex} = choices[side];
      if (selectedIndex < 0 || options[selectedIndex].disabled)
        choices[side].value = [...options].find((option) => !option.disabled).value;
    });
  }

  function words() {
    const [first, second] = sides.map((side) => choices[side].value);
    const place = `from ${choices.viewpoint.value}`, share = Math.round(border.value);
    if (way() === "flip") return `${flipped ? second : first}, ${place}`;
    if (way() === "difference") return `Difference of ${first} and ${second}, ${place}`;
    return `${first} up to ${share} % of the width, ${second} beyond, ${place}`;
  }

  function show() {
    const by = way();
    sides.forEach((side, i) => {
      const source = here().get(choices[side].value);
      if (images[i].src !== source) images[i].src = source;
      labels[i].textContent = choices[side].value;
      labels[i].hidden = by === "flip" && flipped !== (i === 1);
    });
    root.dataset.way = by;
    root.classList.toggle("flipped", flipped);
    stage.style.setProperty("--border", `${border.value}%`);
    one(".stage i").hidden = by !== "slider";
    root.querySelectorAll(":scope > [data-way]").forEach((control) => {
      control.hidden = control.dataset.way !== by;
    });
    stage.setAttribute("aria-label", words());
    border.setAttribute("aria-valuetext", words());
  }

  const say = () => { spoken.textContent = words(); };

  function turn() {
    flipped = !flipped;
    show();
  }

  function keepTurning() {
    clearInterval(timer);
    timer = byItself.checked && way() === "flip" ? setInterval(turn, FLIP_MS) : 0;
  }

  function slideTo(event) {
    const box = stage.getBoundingClientRect();
    border.value = (100 * (event.clientX - box.left)) / box.width;
    show();
  }

  Object.values(choices).forEach((select) => select.addEventListener("change", () => {
    offer();
    show();
    say();
  }));
  root.querySelectorAll("[name=compare-by]").forEach((radio) =>
    radio.addEventListener("change", () => { show(); say(); keepTurning(); }));
  border.addEventListener("input", show);
  flip.addEventListener("click", () => { turn(); say(); });
  byItself.addEventListener("change", keepTurning);
  stage.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    if (way() === "flip") { turn(); say(); }
    if (way() !== "slider") return;
    stage.setPointerCapture(event.pointerId);
    slideTo(event);
  });
  stage.addEventListener("pointermove", (event) => {
    if (stage.hasPointerCapture(event.pointerId)) slideTo(event);
  });

  // A viewpoint of which a page has no two pictures cannot be compared.
  [...choices.viewpoint.options].forEach((option) => {
    option.disabled = (sources.get(option.value) || new Map()).size < 2;
  });
  const usable = [...choices.viewpoint.options].filter((option) => !option.disabled);
  if (!usable.length) return;
  if (!usable.some((option) => option.selected)) choices.viewpoint.value = usable[0].value;
  offer();
  show();
  root.hidden = false;
})();
