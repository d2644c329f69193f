// What an eye sees of a display: the same rays as the ray tracer's `inim_eye` sensor and
// `inim_display` emitter, for the lens models `pinhole` and `thin`. Display frame, millimetres:
// origin at the centre of the lens array, +x right, +y up, +z towards the viewer.
// The script defines, above this, what a display has: THIN lenses, COLORED, HEXAGONAL, APERTURE,
// ROUND_APERTURE, CLEAR_BETWEEN, TURNED, TILTED. What it does not have is not compiled.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform vec3 eye;
uniform vec2 size;         // of the lens array, which fills the canvas
uniform vec2 canvas;       // in pixels
uniform int grid;          // samples along one side of a canvas pixel
uniform vec2 pitch;        // between lenses of a row; between rows
uniform vec2 lenses;       // columns, rows
uniform float gap;
uniform vec3 power;        // 1 / f for red, green and blue
uniform float half_aperture;
uniform vec2 shift;        // where the array lies over the panel
uniform vec2 turn;         // cosine and sine of its rotation
uniform vec2 tilt;         // growth of the gap per millimetre
uniform float pixel;       // panel pixel
uniform ivec2 panel_size;  // columns, rows
uniform sampler2D panel;   // sRGB, which the card makes linear; row 0 on top
out vec4 shown;

vec3 srgb_from_linear(vec3 light) {
  vec3 curve = 1.055 * pow(max(light, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(curve, 12.92 * light, vec3(lessThanEqual(light, vec3(0.0031308))));
}

// Centre of the lens whose cell holds a point, and whether the array reaches that far (1 or 0).
#ifdef HEXAGONAL
// The nearest one in a row counted from the bottom; and its distance^2.
vec4 in_row(vec2 point, float row) {
  float from_top = lenses.y - 1.0 - row;
  float odd = from_top - 2.0 * floor(from_top / 2.0);
  float aside = lenses.y > 1.0 ? odd / 2.0 - 0.25 : 0.0;
  float column = floor(point.x / pitch.x + lenses.x / 2.0 - aside);
  vec2 centre = (vec2(column + aside, row) + 0.5 - lenses / 2.0) * pitch;
  bool inside = column >= 0.0 && column < lenses.x && row >= 0.0 && row < lenses.y;
  return vec4(centre, inside ? 1.0 : 0.0, dot(point - centre, point - centre));
}

vec3 lens_centre(vec2 point) {
  float lower = floor(point.y / pitch.y + lenses.y / 2.0 - 0.5);
  vec4 below = in_row(point, lower), above = in_row(point, lower + 1.0);
  return above.w < below.w ? above.xyz : below.xyz;
}
#else
vec3 lens_centre(vec2 point) {
  vec2 cell = floor(point / pitch + lenses / 2.0);
  vec2 inside = step(vec2(0.0), cell) * step(cell, lenses - 1.0);
  return vec3((cell + 0.5 - lenses / 2.0) * pitch, inside.x * inside.y);
}
#endif

bool in_aperture(vec2 off) {
#ifdef ROUND_APERTURE
  return dot(off, off) <= half_aperture * half_aperture;
#else
  return all(lessThanEqual(abs(off), half_aperture * vec2(1.0, pitch.y / pitch.x)));
#endif
}

// Linear light of the panel pixel that a ray lands on: it crosses z = 0 at `point` and travels
// `slope` sideways per millimetre away from the viewer.
vec3 panel_light(vec2 point, vec2 slope, float lens_power) {
#ifdef TURNED
  mat2 to_array = mat2(turn.x, -turn.y, turn.y, turn.x);
  point = to_array * (point - shift);
  slope = to_array * slope;
#endif
  vec3 lens = lens_centre(point);
  float lit = lens.z;
#ifdef THIN
  vec2 run = slope - (point - lens.xy) * lens_power;
  vec2 landed = point + gap * run;
#else
  vec2 run = slope;
  vec2 landed = lens.xy + gap * run;
#endif
#ifdef APERTURE
  if (!in_aperture(point - lens.xy)) {
#ifdef CLEAR_BETWEEN
    run = slope;
    landed = point + gap * run;
#else
    lit = 0.0;
#endif
  }
#endif
#ifdef TURNED
  mat2 from_array = mat2(turn.x, turn.y, -turn.y, turn.x);
  landed = from_array * landed + shift;
  run = from_array * run;
#endif
#ifdef TILTED
  landed += run * dot(tilt, landed) / (1.0 - dot(tilt, run));
#endif
  vec2 spot = floor(vec2(landed.x, -landed.y) / pixel + 0.5 * vec2(panel_size));
  vec2 on_panel = step(vec2(0.0), spot) * step(spot, vec2(panel_size) - 1.0);
  // A fetch beside the panel is undefined, so it is aimed inside and not counted.
  vec2 place = clamp(spot, vec2(0.0), vec2(panel_size) - 1.0);
  return lit * on_panel.x * on_panel.y * texelFetch(panel, ivec2(place), 0).rgb;
}

void main() {
  vec3 sum = vec3(0.0);
  float n = float(grid);
  for (int j = 0; j < grid; ++j) {
    for (int i = 0; i < grid; ++i) {
      // One sample in each cell of a grid, sheared so that no two share a column or a row.
      vec2 cell = vec2(float(i), float(j));
      vec2 within = (cell + (cell.yx + 0.5) / n) / n;
      vec2 point = ((floor(gl_FragCoord.xy) + within) / canvas - 0.5) * size;
      vec2 slope = (point - eye.xy) / eye.z;
#ifdef COLORED
      sum.r += panel_light(point, slope, power.r).r;
      sum.g += panel_light(point, slope, power.g).g;
      sum.b += panel_light(point, slope, power.b).b;
#else
      sum += panel_light(point, slope, power.g);
#endif
    }
  }
  shown = vec4(srgb_from_linear(sum / (n * n)), 1.0);
}
