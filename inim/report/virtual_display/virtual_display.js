"use strict";
/* The virtual display: draws elemental image arrays through their lens array, live.

   Reads the block #virtual-display-data and drives the elements of #virtual-display-live. Where
   anything is missing (WebGL 2, a texture large enough), it says so in #virtual-display-why and
   leaves the pre-rendered views in their place.

   For tests and for the console, `window.inimDisplay`, lengths in millimetres:
     ready               a promise: true once it draws, false where it cannot
     eye()               [x, y, z]
     setEye(x, y, z)     moves the eye (within reach), returns eye(); the frame follows
     flipLimit(z)        [x, y]: how far off axis no lens shows a flipped view
     state()             {lensModel, panels: [left, right], isOutside, isResting, isSwaying, eyes,
                         grid, frames}: `grid` x `grid` samples a pixel in the last of `frames`
                         drawn so far, none to come if it is resting; `eyes` as drawn, by screen
     pixels(side, w, h)  {width, height, data}: the view of screen 0 or 1 drawn at w x h with all
                         samples; data is base64 of RGBA bytes, top row first
     timeFrame(grid)     promise of the milliseconds that drawing every screen once took, with
                         grid x grid samples */
(() => {
  const live = document.getElementById("virtual-display-live");
  const block = document.getElementById("virtual-display-data");
  if (!live || !block) return;
  const data = JSON.parse(block.textContent);
  const optics = data.optics;

  const REST_GRIDS = [2, 4, 8];  // refined in turn; 64 samples a pixel where the card is up to it
  const FULL_GRID = 8;
  const MOVING_GRIDS = [4, 3, 2, 1];
  const MOVING_PER_LENS = 4;    // canvas pixels along a lens, where that is too slow
  const MOVING_MS = 12;         // leaves room in a frame of 1/60 s
  const REST_MS = 1000;         // a frame may take while nothing moves
  const LARGEST_SIDE_PX = 1400;
  const SWAY_S = 10;            // there and back

  /* ---- the eye, and where it may go -------------------------------------------------------- */

  // Of the viewing half-angle.
  const tangent = Math.max(...optics.elemental_pitch_mm) / (2 * optics.gap_mm);
  const home = data.viewpoints[0].position_mm;
  const distances = data.viewpoints.map((v) => v.position_mm[2]);
  const nearest = Math.max(1.1 * optics.front_mm, Math.min(...distances) / 8);
  const farthest = 8 * Math.max(...distances);
  let eye = [...home];

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  // Three half-angles: all of the neighbouring views beside the display's own.
  const reach = (z) => 3 * tangent * z;

  function setEye(x, y, z) {
    if (![x, y, z].every(Number.isFinite)) return eye;
    const distance = clamp(z, nearest, farthest), side = reach(distance);
    eye = [clamp(x, -side, side), clamp(y, -side, side), distance];
    return eye;
  }

  // As `Display.flip_limit_mm`: across and along the array.
  function flipLimit(z) {
    return [0, 1].map((axis) => {
      if (axis && optics.traits.includes("CYLINDERS")) return Infinity;
      const pitch = optics.pitch_mm[axis], elemental = optics.elemental_pitch_mm[axis];
      const walk = Math.abs(1 + optics.gap_mm / z - elemental / pitch);
      return ((elemental / 2 - optics.outermost_mm[axis] * walk) * z) / optics.gap_mm;
    });
  }

  // A pair of eyes lies across the display, its middle where one eye would be.
  const isPair = () => Boolean(pair && pair.checked);
  const apart = () => clamp(Number(between.value) || 0, 0, Number(between.max));
  const eyeOf = (side) => isPair() ? [eye[0] + (side - 0.5) * apart(), eye[1], eye[2]] : eye;
  const eyes = () => isPair() ? [eyeOf(0), eyeOf(1)] : [eye];

  // How far the outer eye is across and along the array, from its centre: those limits count there.
  function fromArray() {
    const [cosine, sine] = optics.turn;
    const offsets = eyes().map(([ex, ey]) => {
      const [x, y] = [ex - optics.shift_mm[0], ey - optics.shift_mm[1]];
      return [cosine * x + sine * y, cosine * y - sine * x].map(Math.abs);
    });
    return [0, 1].map((axis) => Math.max(...offsets.map((offset) => offset[axis])));
  }

  /* ---- drawing ----------------------------------------------------------------------------- */

  class CannotDraw extends Error {}

  function compiled(gl, kind, source) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source.trim());
    gl.compileShader(shader);
    return shader;
  }

  /* One screen: a canvas, its context and the panel it shows. */
  class Screen {
    constructor(canvas, side) {
      this.canvas = canvas;
      this.side = side;
      this.panel = -1;
      const gl = canvas.getContext("webgl2",
        {alpha: false, antialias: false, depth: false, powerPreference: "high-performance"});
      if (!gl) throw new CannotDraw("This browser has no WebGL 2, or it is switched off.");
      this.gl = gl;
      const limit = gl.getParameter(gl.MAX_TEXTURE_SIZE);
      if (Math.max(...optics.panel) > limit)
        throw new CannotDraw(
          `The panel has ${optics.panel.join(" × ")} pixels; this graphics card takes ${limit}.`);
      this.prepare();
    }

    prepare() {
      const gl = this.gl;
      this.programs = {pinhole: this.program([]), thin: this.program(["THIN"])};
      if (optics.thick) this.programs.thick = this.program(["THICK"]);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      // The very code values: no colour management, no premultiplication, row 0 first.
      gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
      gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, false);
    }

    /* A program for one lens model, and where its uniforms are. */
    program(model) {
      const gl = this.gl, program = gl.createProgram();
      const traits = [...optics.traits, ...model]
        .filter((trait) => trait !== "COLORED" || model.length > 0);
      const head = ["#version 300 es", ...traits.map((trait) => `#define ${trait}`), ""];
      const [vertices, pixels] = [["#define VERTEX", ""], []]
        .map((stage) => [...head, ...stage].join("\n") + data.shader);
      gl.attachShader(program, compiled(gl, gl.VERTEX_SHADER, vertices));
      gl.attachShader(program, compiled(gl, gl.FRAGMENT_SHADER, pixels));
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
        throw new CannotDraw("This graphics card does not take the display's shader.");
      gl.useProgram(program);
      const at = (name) => gl.getUniformLocation(program, name);
      gl.uniform2fv(at("size"), optics.size_mm);
      gl.uniform2fv(at("pitch"), optics.pitch_mm);
      gl.uniform2fv(at("lenses"), optics.lenses);
      gl.uniform1f(at("gap"), optics.gap_mm);
      gl.uniform3fv(at("power"), optics.power_per_mm);
      gl.uniform3fv(at("index"), optics.index);
      if (optics.thick) {
        gl.uniform1f(at("curvature"), optics.thick.curvature_per_mm);
        gl.uniform1f(at("foot"), optics.thick.foot_mm);
        gl.uniform1f(at("thickness"), optics.thick.thickness_mm);
        gl.uniform1f(at("design_index"), optics.thick.design_index);
        gl.uniform1f(at("exposure"), optics.thick.exposure);
        if (optics.layers.length) gl.uniform2fv(at("layers"), optics.layers.flat());
      }
      gl.uniform1f(at("half_aperture"), optics.half_aperture_mm);
      gl.uniform2fv(at("shift"), optics.shift_mm);
      gl.uniform2fv(at("turn"), optics.turn);
      gl.uniform2fv(at("tilt"), optics.tilt);
      gl.uniform1f(at("pixel"), optics.pixel_mm);
      gl.uniform3fv(at("white"), optics.white);
      gl.uniform1f(at("black"), optics.black_level);
      gl.uniform1f(at("ambient"), optics.ambient_reflection);
      gl.uniform1f(at("glare"), optics.veiling_glare);
      gl.uniform2iv(at("panel_size"), optics.panel);
      gl.uniform4fv(at("areas"), optics.areas.flat());
      gl.uniform3fv(at("brightness"), optics.brightness);
      if (optics.cells.length) gl.uniform2fv(at("cells"), optics.cells.flat());
      gl.uniform1iv(at("kinds"), optics.kinds);
      return {program, eye: at("eye"), canvas: at("canvas"), grid: at("grid")};
    }

    show(index, image) {
      const gl = this.gl;
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8, gl.RGB, gl.UNSIGNED_BYTE, image);
      this.panel = index;
    }

    /* Give the canvas as many pixels as it has on the screen, or `perLens` along each lens. */
    fit(perLens = Infinity) {
      const box = this.canvas.getBoundingClientRect();
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const [columns, rows] = optics.lenses;
      const scale = Math.min(ratio, LARGEST_SIDE_PX / Math.max(box.width, box.height, 1),
        perLens * Math.max(columns / box.width, rows / box.height));
      this.resize(Math.round(box.width * scale), Math.round(box.height * scale));
    }

    resize(width, height) {
      const changed = this.canvas.width !== width || this.canvas.height !== height;
      if (!changed || !width || !height) return;
      this.canvas.width = width;
      this.canvas.height = height;
    }

    draw(samples) {
      const gl = this.gl, {width, height} = this.canvas, at = this.programs[lensModel];
      gl.viewport(0, 0, width, height);
      gl.useProgram(at.program);
      gl.uniform2f(at.canvas, width, height);
      gl.uniform3fv(at.eye, eyeOf(this.side));
      gl.uniform1i(at.grid, samples);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    /* Resolves when all that was drawn is done. */
    finished() {
      const gl = this.gl, sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
      return new Promise((resolve) => {
        const look = () => {
          if (sync && gl.getSyncParameter(sync, gl.SYNC_STATUS) === gl.UNSIGNALED)
            setTimeout(look, 1);
          else resolve();
        };
        setTimeout(look, 1);
      });
    }

    read() {
      const gl = this.gl, {width, height} = this.canvas, row = 4 * width;
      const upwards = new Uint8Array(row * height), downwards = new Uint8Array(row * height);
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, upwards);
      for (let y = 0; y < height; ++y)
        downwards.set(upwards.subarray(y * row, (y + 1) * row), (height - 1 - y) * row);
      return downwards;
    }
  }

  /* ---- elements ---------------------------------------------------------------------------- */

  const all = (selector) => [...live.querySelectorAll(selector)];
  const figures = all(".screens figure"), canvases = all("canvas"), selects = all("select");
  const heads = all(".screens .side"), above = live.querySelector("svg.above");
  const pair = live.querySelector("input[name=pair]");
  const between = live.querySelector("input[name=between]");
  const sliders = Object.fromEntries(all("input[type=range]").map((s) => [s.name, s]));
  const readout = live.querySelector(".readout"), sign = live.querySelector(".sign");
  const spoken = live.querySelector("[role=status]");
  const together = live.querySelector("input[name=together]");
  const why = document.getElementById("virtual-display-why");
  const images = data.panels.map(() => null);
  const chosen = data.start;
  let screens = [], lensModel = "pinhole";

  const shownScreens = () => screens.filter((_, side) => !figures[side].hidden);
  const isOutside = () => {
    const limit = flipLimit(eye[2]);
    return fromArray().some((offset, axis) => offset > limit[axis]);
  };

  /* ---- words ------------------------------------------------------------------------------- */

  const number = (value, digits) => {
    const text = Math.abs(value).toFixed(digits);
    return (value < 0 && Number(text) !== 0 ? "−" : "") + text;
  };
  const degrees = (offset) => number((Math.atan(offset / eye[2]) * 180) / Math.PI, 1) + "°";

  function zoneWords() {
    const limit = flipLimit(eye[2]);
    if (Math.min(...limit) < 0)
      return "Too close: some lenses show a neighbour's picture wherever the eye is.";
    const offset = fromArray();
    const over = ["across", "up or down"]
      .map((word, axis) => [offset[axis] - limit[axis], word])
      .filter(([excess]) => excess > 0)
      .map(([excess, word]) => `${number(excess, 1)} mm too far ${word}`);
    return over.length
      ? `Outside the viewing zone, ${over.join(" and ")}: the picture flips.`
      : `Inside the viewing zone: ±${number(limit[0], 1)} mm across, ` +
        `±${number(limit[1], 1)} mm up and down at this distance.`;
  }

  function say() {
    const [x, y, z] = eye, outside = isOutside();
    readout.textContent =
      `Eye at x ${number(x, 1)}, y ${number(y, 1)}, z ${number(z, 0)} mm ` +
      `(${degrees(x)} across, ${degrees(y)} up)` +
      (isPair() ? `, two of them ${number(apart(), 0)} mm apart` : "");
    sign.textContent = zoneWords();
    sign.classList.toggle("outside", outside);
    figures.forEach((figure) => figure.classList.toggle("outside", outside));
    drawAbove();
    const sides = {x: ["left", "right"], y: ["down", "up"]};
    [["x", x], ["y", y]].forEach(([name, value]) => {
      const slider = sliders[name];
      slider.min = -reach(z);
      slider.max = reach(z);
      slider.value = value;
      slider.setAttribute("aria-valuetext",
        `${number(Math.abs(value), 1)} mm ${sides[name][value < 0 ? 0 : 1]}`);
    });
    sliders.z.value = Math.log(z / nearest) / Math.log(farthest / nearest);
    sliders.z.setAttribute("aria-valuetext", `${number(z, 0)} mm`);
    all("button[data-viewpoint]").forEach((button) => {
      const at = data.viewpoints[button.dataset.viewpoint].position_mm;
      const there = at.every((value, axis) => Math.abs(value - eye[axis]) < 1e-6);
      button.setAttribute("aria-pressed", String(there));
    });
    canvases.forEach((canvas, side) => {
      canvas.setAttribute("aria-label",
        `${data.panels[chosen[side]].name} through ${lensModel} lenses. ${readout.textContent}. ` +
        sign.textContent);
    });
  }

  /* Display, viewing zone and eye from above, the viewer below; drawn to one scale. */
  function drawAbove() {
    const [left, top, width, height] = above.getAttribute("viewBox").split(" ").map(Number);
    const z = eye[2], deepest = 1.2 * Math.max(z, home[2]);
    const half = optics.size_mm[0] / 2;
    const reaches = Math.max(half, ...eyes().map(([x]) => Math.abs(x)), flipLimit(deepest)[0]);
    const scale = Math.min((height + top) / deepest, -left / (1.1 * reaches));
    const at = (x, depth) => `${(x * scale).toFixed(2)},${(depth * scale).toFixed(2)}`;
    const deep = (height + top) / scale, edges = [];
    for (let i = 0; i <= 32; ++i) {
      const depth = (deep * i) / 32, limit = depth ? flipLimit(depth)[0] : -1;
      if (limit >= 0) edges.push([limit, depth]);
    }
    const middle = optics.shift_mm[0];
    const outline = [...edges, ...edges.map(([limit, depth]) => [-limit, depth]).reverse()];
    above.querySelector(".zone").setAttribute("points",
      outline.map(([limit, depth]) => at(middle + limit, depth)).join(" "));
    above.querySelector(".panel").setAttribute("points", `${at(-half, 0)} ${at(half, 0)}`);
    [...above.querySelectorAll("g")].forEach((group, side) => {
      const one = eyes()[side];
      group.setAttribute("visibility", one ? "visible" : "hidden");
      if (!one) return;
      const [sight, dot] = group.children;
      sight.setAttribute("points", `${at(-half, 0)} ${at(one[0], one[2])} ${at(half, 0)}`);
      dot.setAttribute("cx", one[0] * scale);
      dot.setAttribute("cy", one[2] * scale);
    });
    above.setAttribute("aria-label",
      `From above: the display is ${number(2 * half, 0)} mm wide. ${readout.textContent}. ` +
      sign.textContent);
  }

  /* ---- frames: as many samples as there is time for; one frame at a time ------------------- */

  let emptyMs = 4, sampleMs = Infinity;  // of a frame without samples, and of one sample
  let grid = 0, frames = 0, movedSince = false, running = false, speaking = 0;

  // What a frame takes however few its samples; the first ones compile and do not count.
  async function timeEmptyFrames() {
    const took = [];
    for (let i = 0; i < 7; ++i) {
      const started = performance.now();
      screens.forEach((screen) => { screen.resize(16, 16); screen.draw(1); });
      await Promise.all(screens.map((screen) => screen.finished()));
      took.push(performance.now() - started);
    }
    emptyMs = Math.min(...took.slice(2));
  }

  const pixelCount = () => shownScreens()
    .reduce((sum, {canvas}) => sum + canvas.width * canvas.height, 0);

  async function paint(samples, perLens) {
    const drawn = shownScreens(), started = performance.now();
    for (const screen of drawn) {
      screen.fit(perLens);
      screen.draw(samples);
    }
    grid = samples;
    await Promise.all(drawn.map((screen) => screen.finished()));
    frames += 1;
    const count = pixelCount() * samples ** 2;
    if (!count) return;
    // What is longer than before is mostly others' doing: believed by half.
    const took = performance.now() - started;
    emptyMs = Math.min(emptyMs, took);
    const found = Math.max(took - emptyMs, 0.2) / count;
    sampleMs = Math.min(found, 0.5 * (sampleMs + found));
  }

  // The most samples of all pixels that MOVING_MS allows; else MOVING_PER_LENS, however slow.
  function affordable() {
    const whole = shownScreens().reduce((sum, {canvas}) => {
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      return sum + canvas.clientWidth * canvas.clientHeight * ratio ** 2;
    }, 0);
    const samples = MOVING_GRIDS.find((n) => whole * n ** 2 * sampleMs <= MOVING_MS);
    return samples ? [samples] : [1, MOVING_PER_LENS];
  }

  const nextFrame = () => new Promise(requestAnimationFrame);

  async function run() {
    if (running) return;
    running = true;
    while (movedSince) {
      await nextFrame();
      movedSince = false;
      say();
      await paint(...affordable());
      for (const samples of REST_GRIDS) {
        await nextFrame();
        const costs = pixelCount() * samples ** 2 * sampleMs;
        if (movedSince || (samples > REST_GRIDS[0] && costs > REST_MS)) break;
        await paint(samples);
      }
    }
    running = false;
  }

  function moved() {
    movedSince = true;
    if (screens.length) run();
    clearTimeout(speaking);
    speaking = setTimeout(() => {
      spoken.textContent = `${readout.textContent}. ${sign.textContent}`;
    }, 700);
  }

  function moveTo(x, y, z) {
    const before = eye;
    setEye(x, y, z);
    if (eye.some((value, axis) => value !== before[axis])) moved();
  }

  /* ---- choosing ------------------------------------------------------------------------------ */

  async function picture(index) {
    if (!images[index]) {
      const image = new Image();
      image.src = data.panels[index].source;
      await image.decode();
      images[index] = image;
    }
    return images[index];
  }

  async function choose(side, index) {
    chosen[side] = index;
    if (isPair() && side === 0) await choose(1, index);
    const image = await picture(index);
    if (chosen[side] !== index) return;
    screens[side].show(index, image);
    moved();
  }

  /* Which screens there are, and what stands above them. */
  function arrange() {
    const both = isPair() || Boolean(together && together.checked);
    figures[1].hidden = !both;
    live.classList.toggle("alone", !both);
    live.classList.toggle("paired", isPair());
    heads.forEach((head, side) => {
      head.textContent = ["Left", "Right"][side] + (isPair() ? " eye" : "");
    });
    if (together) together.disabled = isPair();
    between.disabled = !isPair();
    selects[1].disabled = isPair();
    if (isPair()) selects[1].value = selects[0].value;
    chosen[1] = Number(selects[1].value);
  }

  /* ---- the eye sways until somebody takes it ------------------------------------------------- */

  let isSwaying = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  let isInView = false, phase = 0, swayedAt = 0;

  function sway(now) {
    if (!isSwaying) return;
    if (isInView && screens.length) {
      phase += (2 * Math.PI * Math.min(now - swayedAt, 100)) / (1000 * SWAY_S);
      const [across, along] = flipLimit(home[2]).map((limit) => Math.max(0, limit));
      moveTo(home[0] + 0.5 * across * Math.sin(phase), home[1] + 0.2 * along * Math.sin(2 * phase),
        home[2]);
    }
    swayedAt = now;
    requestAnimationFrame(sway);
  }

  function hold() {
    isSwaying = false;
    live.classList.remove("swaying");
  }

  function startSwaying() {
    live.classList.toggle("swaying", isSwaying);
    if (!isSwaying) return;
    for (const kind of ["pointerdown", "keydown"])
      document.addEventListener(kind, hold, {capture: true, once: true});
    // A slow page is told of several changes at once: the last is how things stand.
    new IntersectionObserver((changes) => {
      isInView = changes[changes.length - 1].isIntersecting;
    }).observe(canvases[0]);
    requestAnimationFrame(sway);
  }

  /* ---- controls ------------------------------------------------------------------------------ */

  function dragging(canvas) {
    const held = new Map();
    const gap = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!held.has(event.pointerId)) return;
      const [x, y] = held.get(event.pointerId);
      const wide = held.size === 2 ? gap() : 0;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 2) {
        moveTo(eye[0], eye[1], (eye[2] * wide) / Math.max(gap(), 1));
      } else if (held.size === 1) {
        // Across the whole canvas: one and a quarter times the whole viewing angle.
        const scale = (2.5 * tangent * eye[2]) / Math.max(canvas.clientWidth, canvas.clientHeight);
        moveTo(eye[0] + (event.clientX - x) * scale, eye[1] - (event.clientY - y) * scale, eye[2]);
      }
    });
    for (const end of ["pointerup", "pointercancel"])
      canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  }

  function scrolling(canvas) {
    canvas.addEventListener("wheel", (event) => {
      // A page must scroll past a canvas that nobody has clicked; a pinch comes as ctrl + wheel.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1, pinch = event.ctrlKey ? 8 : 1;
      moveTo(eye[0], eye[1], eye[2] * Math.exp(0.001 * lines * pinch * event.deltaY));
    }, {passive: false});
  }

  function typing(canvas) {
    canvas.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      const step = ((event.shiftKey ? 0.25 : 0.05) * tangent) * eye[2], [x, y, z] = eye;
      const keys = {
        ArrowLeft: [x - step, y, z], ArrowRight: [x + step, y, z],
        ArrowUp: [x, y + step, z], ArrowDown: [x, y - step, z],
        "+": [x, y, z / 1.1], "=": [x, y, z / 1.1], "-": [x, y, z * 1.1], _: [x, y, z * 1.1],
        Home: home,
      };
      if (!Object.hasOwn(keys, event.key)) return;
      event.preventDefault();
      moveTo(...keys[event.key]);
    });
  }

  /* ---- full screen, and a device that is tilted ------------------------------------------------ */

  // Rows of the rotation from the device's frame to the world's (W3C Device Orientation, Z-X'-Y'').
  function deviceTurn({alpha, beta, gamma}) {
    const [a, b, g] = [alpha || 0, beta, gamma].map((angle) => (angle * Math.PI) / 180);
    const [ca, sa, cb, sb, cg, sg] =
      [a, b, g].flatMap((angle) => [Math.cos(angle), Math.sin(angle)]);
    return [
      [ca * cg - sa * sb * sg, -cb * sa, cg * sa * sb + ca * sg],
      [cg * sa + ca * sb * sg, ca * cb, sa * sg - ca * cg * sb],
      [-cb * sg, sb, cb * cg],
    ];
  }

  // The viewer rests in the world, where the first reading has the middle of the display's eyes.
  let viewer = null;
  function tilted(event) {
    if (event.beta === null || event.gamma === null) return;
    const turn = deviceTurn(event);
    viewer = viewer || turn.map((row) => row[2]);
    const [x, y, z] = [0, 1, 2].map((axis) =>
      turn.reduce((sum, row, k) => sum + row[axis] * viewer[k], 0));
    if (z <= 0) return;
    const angle = (((screen.orientation && screen.orientation.angle) || 0) * Math.PI) / 180;
    const [right, up] = [x * Math.cos(angle) - y * Math.sin(angle),
      x * Math.sin(angle) + y * Math.cos(angle)];
    moveTo((right / z) * eye[2], (up / z) * eye[2], eye[2]);
  }

  async function toggleTilt(button) {
    const starts = button.getAttribute("aria-pressed") === "false";
    if (starts && DeviceOrientationEvent.requestPermission &&
        await DeviceOrientationEvent.requestPermission() !== "granted") return;
    button.setAttribute("aria-pressed", String(starts));
    viewer = null;
    if (starts) window.addEventListener("deviceorientation", tilted);
    else window.removeEventListener("deviceorientation", tilted);
  }

  function connectDevice() {
    const [full] = all("button[name=full]"), [tilt] = all("button[name=tilt]");
    full.hidden = !document.fullscreenEnabled;
    full.addEventListener("click", () => live.querySelector(".screens").requestFullscreen());
    document.addEventListener("fullscreenchange", moved);
    // Browsers give angles to pages of this machine and of https, and of use where a finger points.
    tilt.hidden = !(window.isSecureContext && window.DeviceOrientationEvent &&
      matchMedia("(pointer: coarse)").matches);
    tilt.addEventListener("click", () => toggleTilt(tilt));
  }

  function connect() {
    connectDevice();
    canvases.forEach((canvas) => {
      dragging(canvas);
      scrolling(canvas);
      typing(canvas);
      canvas.addEventListener("webglcontextlost", (event) => {
        event.preventDefault();
        standIn("The graphics card was taken away; the live display waits for it.");
      });
      canvas.addEventListener("webglcontextrestored", start);
    });
    selects.forEach((select, side) =>
      select.addEventListener("change", () => choose(side, Number(select.value))));
    all("button[data-viewpoint]").forEach((button) => button.addEventListener("click", () =>
      moveTo(...data.viewpoints[button.dataset.viewpoint].position_mm)));
    all("input[name=lens-model]").forEach((radio) => radio.addEventListener("change", () => {
      lensModel = radio.value;
      moved();
    }));
    if (together) together.addEventListener("change", () => {
      arrange();
      moved();
    });
    pair.addEventListener("change", () => {
      arrange();
      if (screens.length) choose(1, chosen[1]);
    });
    between.addEventListener("input", moved);
    sliders.x.addEventListener("input", () => moveTo(Number(sliders.x.value), eye[1], eye[2]));
    sliders.y.addEventListener("input", () => moveTo(eye[0], Number(sliders.y.value), eye[2]));
    sliders.z.addEventListener("input", () =>
      moveTo(eye[0], eye[1], nearest * (farthest / nearest) ** Number(sliders.z.value)));
    new ResizeObserver(moved).observe(live);
  }

  /* ---- start ----------------------------------------------------------------------------------- */

  function standIn(reason) {
    live.hidden = true;
    live.parentElement.classList.remove("is-live");
    why.textContent = `${reason} These pre-rendered views replace the live display.`;
  }

  // A browser may keep form choices over a reload; what is chosen is what is drawn.
  function takeChoices() {
    selects.forEach((select, side) => { chosen[side] = Number(select.value); });
    lensModel = live.querySelector("input[name=lens-model]:checked").value;
    arrange();
  }

  /* The pre-rendered views stay until the first frame is complete, at its full size. */
  async function start() {
    running = true;
    try {
      takeChoices();
      const pictures = await Promise.all(canvases.map((_, side) => picture(chosen[side])));
      screens = canvases.map((canvas, side) => new Screen(canvas, side));
      screens.forEach((screen, side) => screen.show(chosen[side], pictures[side]));
    } catch (error) {
      standIn(error instanceof CannotDraw ? error.message : "The panels cannot be read.");
      return false;
    }
    await timeEmptyFrames();
    say();
    await paint(1);
    live.hidden = false;
    live.parentElement.classList.add("is-live");
    running = false;
    moved();
    return true;
  }

  function pixels(side, width, height) {
    const screen = screens[side];
    screen.resize(width, height);
    screen.draw(FULL_GRID);
    const bytes = screen.read();
    let text = "";
    for (let i = 0; i < bytes.length; i += 8192)
      text += String.fromCharCode(...bytes.subarray(i, i + 8192));
    moved();  // and the canvas gets its own size back
    return {width, height, data: btoa(text)};
  }

  async function timeFrame(samples) {
    const started = performance.now();
    for (const screen of shownScreens()) {
      screen.fit();
      screen.draw(samples);
      await screen.finished();
    }
    return performance.now() - started;
  }

  window.inimDisplay = {
    ready: start().then((draws) => {
      if (draws) startSwaying();
      return draws;
    }),
    eye: () => [...eye],
    setEye: (x, y, z) => { hold(); moveTo(x, y, z); say(); return [...eye]; },
    flipLimit,
    state: () => ({
      lensModel, panels: screens.map((s) => s.panel), isOutside: isOutside(), grid,
      isResting: !running && !movedSince, isSwaying, eyes: screens.map((s) => eyeOf(s.side)), frames,
    }),
    pixels,
    timeFrame,
  };
  connect();
})();
