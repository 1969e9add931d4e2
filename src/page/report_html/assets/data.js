// The data of the page, decoded.

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId('data').textContent);
const { grid, report } = data;
const isPair = data.kind === 'pair';

function bytes(id) {
  const text = atob(byId(id).textContent);
  const found = new Uint8Array(text.length);
  for (let i = 0; i < found.length; i++) found[i] = text.charCodeAt(i);
  return found;
}

// Decodes numbers of encoding.rs: zlib, four planes of bytes, zigzag, each a residual of the plane through its
// neighbours.
async function decimals(id, width, digits) {
  const stream = new Blob([bytes(id)]).stream().pipeThrough(new DecompressionStream('deflate'));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 4;
  const integers = new Int32Array(count);
  const found = new Float32Array(count);
  const unit = 10 ** digits;
  const special = new Map([[-(2 ** 31), NaN], [2 ** 31 - 1, Infinity], [1 - 2 ** 31, -Infinity]]);
  for (let i = 0; i < count; i++) {
    const zigzag = (planes[i] | (planes[count + i] << 8) | (planes[2 * count + i] << 16) | (planes[3 * count + i] << 24)) >>> 0;
    const left = i % width ? integers[i - 1] : null;
    const above = i >= width ? integers[i - width] : null;
    const expected = left === null || above === null ? left ?? above ?? 0 : left + above - integers[i - width - 1];
    // A sum of three may overflow, and wraps around.
    integers[i] = expected + ((zigzag >>> 1) ^ -(zigzag & 1));
    const value = integers[i];
    found[i] = Math.abs(value) < 2 ** 31 - 1 ? value / unit : special.get(value);
  }
  return found;
}

const picture = (id) => createImageBitmap(new Blob([bytes(id)], { type: 'image/jpeg' }));

function canvasOf(width, height) {
  const canvas = document.createElement('canvas');
  canvas.width = width;
  canvas.height = height;
  return canvas;
}

// The 256 colours of a map, from far or least to near or greatest.
function colorsOf(map) {
  return Array.from({ length: 256 }, (_, i) => [0, 2, 4].map((at) => parseInt(map.colors.slice(6 * i + at, 6 * i + at + 2), 16)));
}

// The pattern of pixels without information: light and dark grey stripes.
const HATCH = [205, 165].map((grey) => grey | (grey << 8) | (grey << 16) | (255 << 24));

// A field as a picture: transparent where there is no value, striped where `isHatched`; or paler, if it is `filled` in.
function colored(values, map, field, isHatched, filled) {
  const canvas = canvasOf(grid.width, grid.height);
  const context = canvas.getContext('2d');
  const image = context.createImageData(grid.width, grid.height);
  const packed = ([r, g, b]) => r | (g << 8) | (b << 16) | (255 << 24);
  const colors = colorsOf(map).map(packed);
  const pale = colorsOf(map).map((color) => packed(color.map((c) => Math.round(255 - 0.45 * (255 - c)))));
  const pixels = new Uint32Array(image.data.buffer);
  const stripe = Math.max(2, Math.round(grid.width / 240));
  for (let i = 0; i < values.length; i++) {
    const unknown = !isValid(i) || Number.isNaN(values[i]);
    if (filled?.[i] >= 0 && (unknown || isHatched(i))) pixels[i] = pale[Math.round(255 * filled[i])];
    if (unknown || filled?.[i] >= 0) continue;
    const hatch = HATCH[Math.floor(((i % grid.width) + Math.floor(i / grid.width)) / stripe) % 2];
    pixels[i] = isHatched(i) ? hatch : colors[Math.round(255 * field.position(values[i]))];
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

// Depth in mm from V, as the program inverts a lens (src/base/lens.rs).
function lensInverse({ scale, limit }, lens) {
  const { focal_length_mm: f, f_number: n, pixel_pitch_mm: pitch, focus_mm: focus, kappa, telecentric } = lens;
  const coordinate = (z) => (telecentric ? (f * z) / (z - f) : 1 / z);
  const depthAt = (x) => (telecentric ? f / (1 - f / x) : 1 / x);
  const strength = (u) => ((kappa * (telecentric ? 1 : (f * f * u) / (u - f))) / (2 * n) / pitch) ** 2;
  const [x1, x2] = focus.map(coordinate);
  const [k1, k2] = [strength(focus[0]), strength(focus[1]) / scale ** 2];
  const [c0, c1, c2] = [k2 * x2 * x2 - k1 * x1 * x1, -2 * (k2 * x2 - k1 * x1), k2 - k1];
  const [vertex, middle] = [-c1 / (2 * c2), (x1 + x2) / 2];
  let [low, high] = telecentric ? [f, Infinity] : [0, 1 / f];
  if (vertex > middle) high = Math.min(vertex, high);
  else if (vertex > low) low = vertex;
  const range = [high, low].map(depthAt);
  const rising = c1 + 2 * c2 * middle > 0;
  const inRange = (v) => {
    const root = Math.sqrt(c1 * c1 - 4 * c2 * (c0 - v));
    const slope = rising ? root : -root;
    const z = depthAt(slope * c1 >= 0 ? (2 * (v - c0)) / (c1 + slope) : (slope - c1) / (2 * c2));
    return z >= range[0] && z <= range[1] && Number.isFinite(z) ? z : NaN;
  };
  const depth = (v) => (Math.abs(v) < 0.999 * (limit ?? Infinity) ? inRange(v) : NaN);
  const end = (z, otherwise) => (Number.isNaN(z) ? otherwise : z);
  const deviation = (v, sigma) => {
    const [nearer, farther] = rising ? [v + sigma, v - sigma] : [v - sigma, v + sigma];
    return Number.isNaN(depth(v)) ? NaN : (end(inRange(farther), range[1]) - end(inRange(nearer), range[0])) / 2;
  };
  return { depth, deviation };
}

// Fields that are computed from other fields.
const formulas = {
  confidence: () => fields.uncertainty.values.map((sigma) => (Number.isNaN(sigma) ? 0 : 1 / (1 + sigma * sigma))),
  depth: () => fields.relative_blur.values.map(lensInverse(data.lens, report.depth.lens).depth),
  depth_deviation: () => {
    const { deviation } = lensInverse(data.lens, report.depth.lens);
    return fields.relative_blur.values.map((v, i) => deviation(v, fields.uncertainty.values[i]));
  },
};

// A value at each pixel: its name, its colours, and its scale.
class Field {
  constructor(described) {
    Object.assign(this, described);
    this.title = this.unit ? `${this.name}, ${this.unit}` : this.name;
  }

  // Logarithms have two decimals. Fields that depend on others come after these.
  async unpack() {
    if (this.computed) return;
    const values = await decimals(`field-${this.key}`, grid.width, this.logarithms ? 2 : this.digits);
    this.values = this.logarithms ? values.map(Math.exp) : values;
  }

  compute() {
    if (this.computed) this.values = formulas[this.key]();
  }

  // The position between the low end, 0, and the high end, 1.
  share(value) {
    const { low, high } = this;
    const t = this.logarithmic ? Math.log(Math.max(value, low) / low) / Math.log(high / low) : (value - low) / (high - low);
    return Math.min(1, Math.max(0, t));
  }

  value(t) {
    const { low, high } = this;
    return this.logarithmic ? low * (high / low) ** t : low + t * (high - low);
  }

  // The position along the colour map, and that of heights.
  position(value) {
    return this.reversed ? 1 - this.share(value) : this.share(value);
  }

  text(value) {
    if (Number.isNaN(value)) return 'not valid';
    if (!Number.isFinite(value)) return value > 0 ? 'beyond' : '−beyond';
    if (this.logarithmic) return significant(value, 3);
    return this.low < 0 ? signed(value, this.digits) : plain(value, this.digits);
  }

  // Round values between the ends, with their positions and texts.
  ticks(count) {
    const { low, high } = this;
    if (!this.logarithmic) {
      const { ticks, digits } = roundTicks(low, high, count);
      return ticks.map((value) => ({ value, at: this.share(value), text: plain(value, digits) }));
    }
    const found = [];
    const wide = high / low > 300;
    for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power++) {
      for (const k of wide ? [1] : [1, 2, 5]) {
        const value = k * 10 ** power;
        const text = power < -3 ? `${k}e−${-power}` : plain(value, Math.max(0, -power));
        if (value >= low * 0.9999 && value <= high * 1.0001) found.push({ value, at: this.share(value), text });
      }
    }
    return found;
  }
}

const { filled, ...fields } = Object.fromEntries(data.fields.map((described) => [described.key, new Field(described)]));
// Where this field has no value, the other fields mean little.
const [principal] = Object.values(fields);
const isValid = (i) => !Number.isNaN(principal.values[i]);

// The main field and its standard deviation: depth in mm if it is known, else V or the focus.
const main = fields.depth ?? principal;
const sureness = fields.depth_deviation ?? fields.uncertainty;
const TRUST = ['uncertainty', 'depth_deviation', 'confidence', 'residual'];

// A number with this many significant digits, never as a power of ten.
function significant(value, digits) {
  if (!(value > 0)) return '0';
  return plain(value, Math.min(8, Math.max(0, digits - 1 - Math.floor(Math.log10(value)))));
}

// A value with its standard deviation, to two digits of the latter: "−36.8 ± 2.6".
function withDeviation(value, sigma, field) {
  // Depth towards infinity has no standard deviation.
  if (Number.isNaN(value) || !Number.isFinite(sigma)) return 'not measured';
  if (!(sigma > 0)) return field.text(value);
  const digits = Math.min(field.digits, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
  return `${field.low < 0 ? signed(value, digits) : plain(value, digits)} ± ${plain(sigma, digits)}`;
}

// The σ above which pixels are hatched; the reader may lower it.
let threshold = Infinity;
const noTexture = report.texture?.max_uncertainty_px2 ?? Infinity;
const isUnsure = (i) => sureness.values[i] > threshold || fields.uncertainty.values[i] > noTexture;
const isMeasured = (i) => Number.isFinite(main.values[i]) && !isUnsure(i);

// The quantiles of the finite numbers at these shares.
function quantiles(values, shares, counts = isMeasured) {
  const found = [];
  const step = Math.max(1, Math.floor(values.length / 400000));
  for (let i = 0; i < values.length; i += step) if (counts(i) && Number.isFinite(values[i])) found.push(values[i]);
  found.sort((a, b) => a - b);
  return shares.map((share) => (found.length ? found[Math.round(share * (found.length - 1))] : null));
}

function measuredShare() {
  let count = 0;
  for (let i = 0; i < main.values.length; i++) if (isMeasured(i)) count++;
  return count / main.values.length;
}

// A number with a typographic minus sign.
function plain(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(text) ? '−' : '') + text;
}

// A number with a sign in any case.
function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(text) ? '−' : '+') + text;
}

// Ticks at round values between two, about `count` of them.
function roundTicks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}
