// What an eye sees of a display: the same rays as the ray tracer's `inim_eye` sensor and
// `inim_display` emitter, for the lens models `pinhole`, `thin` and `thick` (spherical, as `inim.lens.thick`). Display frame,
// millimetres:
// origin at the centre of the lens array, +x right, +y up, +z towards the viewer.
// The script defines, above this, what a display has: THIN or THICK lenses, COLORED, APERTURE,
// ROUND_APERTURE, CLEAR_BETWEEN, TURNED, TILTED, BULGES_TO_VIEWER, GLARE, LAYERS (their number), and
// TOUCHING if no air is before the layers, CYLINDERS for lenses, AREAS if colours do not shine all over
// a pixel, CELLS (their number) if they shine elsewhere in some pixels. What it does not have is not compiled. The code of its layout
// is inserted below. VERTEX is the vertex shader, which covers the canvas with one triangle.
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
uniform vec3 index;        // of refraction, for red, green and blue
uniform float curvature;   // of the bulges, along the light's way
uniform float foot;        // depth of their relief
uniform float thickness;
uniform float design_index;
uniform float exposure;    // makes the panel's white white on the axis, whatever the faces reflect
uniform float half_aperture;
uniform vec2 shift;        // where the array lies over the panel
uniform vec2 turn;         // cosine and sine of its rotation
uniform vec2 tilt;         // growth of the gap per millimetre
uniform float pixel;       // panel pixel
uniform ivec2 panel_size;  // columns, rows
#ifdef AREAS
uniform vec4 areas[3];     // of colours: place to the right, half width, half height, chessboard (0, 1, or -1)
uniform vec3 brightness;   // in these areas
#endif
#ifdef CELLS
uniform vec2 cells[3 * CELLS];  // places of colours in kinds of pixels, right and up
uniform int kinds[16];     // of 4 x 4 pixels, from the lower left
#endif
uniform sampler2D panel;   // sRGB, which the card makes linear; row 0 on top
uniform vec3 white;        // of the panel
uniform float black;       // share of the white
uniform float ambient;     // reflected room light
uniform float glare;       // share of light that spreads over the view
#ifdef LAYERS
uniform vec2 layers[LAYERS];  // thickness and index, from the lenses on
#endif

vec3 srgb_from_linear(vec3 light) {
  vec3 curve = 1.055 * pow(max(light, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(curve, 12.92 * light, vec3(lessThanEqual(light, vec3(0.0031308))));
}

// Centre of the lens whose cell holds a point, and whether the array reaches that far (1 or 0).
// lens_centre of the layout

bool in_aperture(vec2 off) {
#ifdef ROUND_APERTURE
  return dot(off, off) <= half_aperture * half_aperture;
#else
  return all(lessThanEqual(abs(off), half_aperture * vec2(1.0, pitch.y / pitch.x)));
#endif
}

#ifdef THICK
const vec3 AGAINST_THE_LIGHT = vec3(0.0, 0.0, -1.0);

// Snell's law for unit vectors; `share` loses what Fresnel's formulas reflect.
vec3 refracted(vec3 d, vec3 against, float ratio, inout float share) {
  float cos_in = -dot(d, against);
  float under = 1.0 - ratio * ratio * (1.0 - cos_in * cos_in);
  if (under <= 0.0 || cos_in <= 0.0) {
    share = 0.0;
    return d;
  }
  float cos_out = sqrt(under), bend = ratio * cos_in - cos_out;
  float r_s = bend / (ratio * cos_in + cos_out);
  float r_p = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out);
  share *= 1.0 - 0.5 * (r_s * r_s + r_p * r_p);
  return ratio * d + bend * against;
}

// The part of a vector in whose direction the faces are curved.
vec2 curved(vec2 vector) {
#ifdef CYLINDERS
  return vec2(vector.x, 0.0);
#else
  return vector;
#endif
}

// Where a ray meets the relief of all bulges, from the lens's vertex: the cell at its foot, or the
// next one on the way. `lens` is that lens's centre.
vec3 on_bulge(vec2 point, vec3 d, out vec2 lens, inout float share) {
  vec2 at = point + d.xy / d.z * foot;
  vec3 spot = vec3(0.0), cell = vec3(0.0);
  bool met = false;
  for (int i = 0; i < 2; ++i) {
    cell = lens_centre(at);
    vec2 off = point - cell.xy, bent = curved(off), run = curved(d.xy);
    float ahead = d.z - curvature * dot(bent, run);
    float under = ahead * ahead - curvature * curvature * dot(bent, bent) * (dot(run, run) + d.z * d.z);
    met = under > 0.0 && ahead > 0.0;
    float path = curvature * dot(bent, bent) / (met ? ahead + sqrt(under) : 1.0);
    spot = vec3(off, 0.0) + path * d;
    at = cell.xy + spot.xy;
  }
  lens = cell.xy;
  share *= met ? cell.z : 0.0;
  return spot;
}

// From the back of a lens, in a medium, through air and layers to the panel; `run` is the slope next to
// the lens.
void through_gap(
    float medium, float air, inout vec2 at, inout vec3 d, inout float share, out vec2 run) {
#ifdef LAYERS
  for (int i = 0; i < LAYERS; ++i) air -= layers[i].x / layers[i].y;
#endif
#ifndef TOUCHING
  if (medium != 1.0) d = refracted(d, AGAINST_THE_LIGHT, medium, share);
  run = d.xy / d.z;
  at += run * air;
  medium = 1.0;
#endif
#ifdef LAYERS
  for (int i = 0; i < LAYERS; ++i) {
    d = refracted(d, AGAINST_THE_LIGHT, medium / layers[i].y, share);
#ifdef TOUCHING
    if (i == 0) run = d.xy / d.z;
#endif
    at += d.xy / d.z * layers[i].x;
    medium = layers[i].y;
  }
#endif
}

// Plano-convex lens: the ray at the panel, and the share of light that gets there.
float through_thick(vec2 point, vec2 slope, float n, out vec2 landed, out vec2 run) {
  float share = exposure;
  vec3 d = normalize(vec3(slope, 1.0));
  vec2 lens;
#ifdef BULGES_TO_VIEWER
  vec3 spot = on_bulge(point, d, lens, share);
  d = refracted(d, vec3(curvature * curved(spot.xy), curvature * spot.z - 1.0), 1.0 / n, share);
  vec2 at = spot.xy + d.xy / d.z * (thickness - spot.z);
  through_gap(n, gap - thickness / design_index, at, d, share, run);
#else
  vec2 vertex = point - d.xy / d.z * thickness / design_index;
  d = refracted(d, AGAINST_THE_LIGHT, 1.0 / n, share);
  vertex += d.xy / d.z * thickness;
  vec3 spot = on_bulge(vertex, d, lens, share);
  d = refracted(d, vec3(curvature * curved(spot.xy), curvature * spot.z - 1.0), n, share);
  vec2 at = spot.xy - d.xy / d.z * spot.z;
  through_gap(1.0, gap, at, d, share, run);
#endif
  landed = lens + at;
  return d.z > 1e-6 ? share : 0.0;
}
#endif

#ifdef AREAS
// Light of each colour at a place in a pixel, to the right and down from its centre.
vec3 emitted(vec2 within, vec2 spot) {
  vec3 light = vec3(0.0);
#ifdef CELLS
  ivec2 place = ivec2(spot.x, float(panel_size.y) - 1.0 - spot.y) & 3;
  int kind = kinds[4 * place.y + place.x];
#endif
  for (int c = 0; c < 3; ++c) {
    vec2 from = within - vec2(areas[c].x, 0.0);
#ifdef CELLS
    from -= vec2(1.0, -1.0) * cells[3 * kind + c];
#endif
    bool shows = from.x < areas[c].y && from.x >= -areas[c].y && from.y < areas[c].z && from.y >= -areas[c].z;
    if (areas[c].w >= 0.0) shows = shows && mod(spot.x + spot.y, 2.0) == areas[c].w;
    if (shows) light[c] = brightness[c];
  }
  return light;
}
#endif

// Linear light of the panel pixel that a ray lands on: it crosses z = 0 at `point` and travels
// `slope` sideways per millimetre away from the viewer. `glass` is 1 / f of thin lenses, n of thick ones.
vec3 panel_light(vec2 point, vec2 slope, float glass) {
#ifdef TURNED
  mat2 to_array = mat2(turn.x, -turn.y, turn.y, turn.x);
  point = to_array * (point - shift);
  slope = to_array * slope;
#endif
#ifdef THICK
  vec2 landed, run;
  float lit = through_thick(point, slope, glass, landed, run);
#else
  vec3 lens = lens_centre(point);
  float lit = lens.z;
#ifdef THIN
  vec2 run = slope - (point - lens.xy) * glass;
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
#endif
#ifdef TURNED
  mat2 from_array = mat2(turn.x, turn.y, -turn.y, turn.x);
  landed = from_array * landed + shift;
  run = from_array * run;
#endif
#ifdef TILTED
  landed += run * dot(tilt, landed) / (1.0 - dot(tilt, run));
#endif
  vec2 in_pixels = vec2(landed.x, -landed.y) / pixel + 0.5 * vec2(panel_size);
  vec2 spot = floor(in_pixels);
  vec2 on_panel = step(vec2(0.0), spot) * step(spot, vec2(panel_size) - 1.0);
  // A fetch beside the panel is undefined, so it is aimed inside and not counted.
  vec2 place = clamp(spot, vec2(0.0), vec2(panel_size) - 1.0);
  vec3 drive = texelFetch(panel, ivec2(place), 0).rgb;
  vec3 shines = vec3(1.0);
#ifdef AREAS
  shines = emitted(in_pixels - spot - 0.5, spot);
#endif
  return lit * on_panel.x * on_panel.y * shines * white * (black + (1.0 - black) * drive);
}

#ifdef THICK
#define GLASS index
#else
#define GLASS power
#endif

// Light of the view at a place of the canvas, 0 to 1 across and up.
vec3 view_light(vec2 place) {
  vec2 point = (place - 0.5) * size;
  vec2 slope = (point - eye.xy) / eye.z;
#ifdef COLORED
  return vec3(
    panel_light(point, slope, GLASS.r).r,
    panel_light(point, slope, GLASS.g).g,
    panel_light(point, slope, GLASS.b).b);
#else
  return panel_light(point, slope, GLASS.g);
#endif
}

#ifdef VERTEX
flat out vec3 mean_light;

void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
  mean_light = vec3(0.0);
#ifdef GLARE
  // The mean of the view, from some rays: glare is a small share of it.
  const int RAYS = 64;
  for (int j = 0; j < RAYS; ++j)
    for (int i = 0; i < RAYS; ++i)
      mean_light += view_light((vec2(float(i), float(j)) + 0.5) / float(RAYS)) / float(RAYS * RAYS);
#endif
}
#else
flat in vec3 mean_light;
out vec4 shown;

void main() {
  vec3 sum = vec3(0.0);
  float n = float(grid);
  for (int j = 0; j < grid; ++j) {
    for (int i = 0; i < grid; ++i) {
      // One sample in each cell of a grid, sheared so that no two share a column or a row.
      vec2 cell = vec2(float(i), float(j));
      vec2 within = (cell + (cell.yx + 0.5) / n) / n;
      sum += view_light((floor(gl_FragCoord.xy) + within) / canvas);
    }
  }
  vec3 light = (1.0 - glare) * sum / (n * n) + glare * mean_light + ambient;
  shown = vec4(srgb_from_linear(light), 1.0);
}
#endif
