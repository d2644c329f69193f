"""Operations of the virtual display on a graphics card, and its frame rate without one.

    python -m tests.frame_rate OUT/report.html

drags the eye about for some seconds in a headless Chromium that draws in software. The counted work
is the same on any machine. The times are this processor's; no graphics card is timed here.
"""

import sys
from pathlib import Path
from typing import Any

from tests.chromium import Tab, browser

#: Put into a page before its own scripts: counts what goes to the graphics card. Each sample of
#: the display's shader reads the panel's texture once, three times where the glass disperses.
COUNT_WORK = """
window.work = {draws: 0, vertices: 0, fragments: 0, samples: 0, uploads: 0};
(() => {
  const type = WebGL2RenderingContext.prototype;
  const {drawArrays, texImage2D, uniform1i} = type;
  type.uniform1i = function (place, value) {
    this.grid = value;
    return uniform1i.call(this, place, value);
  };
  type.drawArrays = function (mode, first, count) {
    const fragments = this.canvas.width * this.canvas.height;
    work.draws += 1;
    work.vertices += count;
    work.fragments += fragments;
    work.samples += fragments * this.grid ** 2;
    return drawArrays.call(this, mode, first, count);
  };
  type.texImage2D = function (...given) {
    work.uploads += 1;
    return texImage2D.apply(this, given);
  };
})();
"""
_SECONDS = 5.0
# A pointer that moves all the time, around the middle of the left canvas.
_DRAG = """
(async (seconds) => {
  const canvas = document.querySelector("#virtual-display canvas");
  canvas.scrollIntoView({block: "center", behavior: "instant"});
  const box = canvas.getBoundingClientRect();
  const at = (turn) => ({
    bubbles: true, pointerId: 1, button: 0, isPrimary: true,
    clientX: box.x + box.width * (0.5 + 0.2 * Math.cos(turn)),
    clientY: box.y + box.height * (0.5 + 0.2 * Math.sin(turn)),
  });
  canvas.setPointerCapture = () => {};  // there is no pointer to capture
  canvas.dispatchEvent(new PointerEvent("pointerdown", at(0)));
  const drawn = inimDisplay.state().frames, begun = performance.now(), chosen = {};
  let turn = 0;
  while (performance.now() - begun < 1000 * seconds) {
    await new Promise((go) => setTimeout(go, 4));
    canvas.dispatchEvent(new PointerEvent("pointermove", at(++turn / 20)));
    const share = (canvas.width / canvas.clientWidth).toFixed(2);
    const how = `${inimDisplay.state().grid ** 2} at ${share}`;
    chosen[how] = (chosen[how] || 0) + 1;
  }
  const took = performance.now() - begun;
  canvas.dispatchEvent(new PointerEvent("pointerup", at(0)));
  return {
    frames: inimDisplay.state().frames - drawn, seconds: took / 1000, chosen,
    width: canvas.clientWidth, height: canvas.clientHeight,
  };
})
"""


def drag_about(tab: Tab, seconds: float) -> dict[str, Any]:
    """Drag the eye in circles.

    Returns
    -------
    dict
        `frames` drawn in `seconds`; `chosen`: how often which samples a pixel at which share of
        the screen's resolution; `width`, `height` of a canvas on the page.
    """
    counts: dict[str, Any] = tab.evaluate(f"{_DRAG}({seconds})")
    return counts


def _report(tab: Tab, model: str) -> None:
    tab.click(f"#virtual-display input[value={model}]")
    tab.until("inimDisplay.state().isResting")
    print(f"{model} lenses")
    for grid in (1, 2, 4, 8):
        took = sorted(tab.evaluate(f"inimDisplay.timeFrame({grid})") for _ in range(5))
        print(f"  {grid * grid:2} samples a pixel: {took[2]:.1f} ms a frame")
    tab.evaluate("Object.keys(work).forEach((key) => { work[key] = 0; })")
    drag = drag_about(tab, _SECONDS)
    work = tab.evaluate("work")
    rate = drag["frames"] / drag["seconds"]
    print(f"  dragging, canvases of {drag['width']} x {drag['height']}: {rate:.0f} frames a second")
    print(f"    a frame: {work['draws'] / drag['frames']:.1f} draws of one triangle, "
          f"{work['samples'] / drag['frames'] / 1e6:.2f} million samples")  # fmt: skip
    share = {cause: n / sum(drag["chosen"].values()) for cause, n in drag["chosen"].items()}
    for cause, part in sorted(share.items(), key=lambda entry: -entry[1]):
        print(f"    {part:4.0%} of the time: samples a pixel {cause} of the resolution")


def main(page: Path) -> None:
    """Print what single frames cost and what dragging does, for both lens models."""
    with browser() as tab:
        tab.send("Page.addScriptToEvaluateOnNewDocument", source=COUNT_WORK)
        tab.size(1280, 900)
        tab.open(page)
        if not tab.evaluate("inimDisplay.ready"):
            sys.exit(f"{page}: no WebGL 2 here, nothing to time")
        for model in ("pinhole", "thin"):
            _report(tab, model)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
