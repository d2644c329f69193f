"""Operations of the virtual display on a graphics card, and a pointer that drags its eye."""

from typing import Any

from tests.chromium import Tab

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
