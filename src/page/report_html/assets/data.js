// What the page holds, unpacked.

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

// Numbers as packed.rs packs them: zlib, four planes of bytes, zigzag, each off the plane through its neighbours.
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
    // A sum of three may leave the range, and wraps.
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

// A field as a picture; nothing where there is no value.
function colored(values, map, field) {
  const canvas = canvasOf(grid.width, grid.height);
  const context = canvas.getContext('2d');
  const image = context.createImageData(grid.width, grid.height);
  const colors = colorsOf(map).map(([r, g, b]) => r | (g << 8) | (b << 16) | (255 << 24));
  const pixels = new Uint32Array(image.data.buffer);
  for (let i = 0; i < values.length; i++) {
    if (isValid(i) && !Number.isNaN(values[i])) pixels[i] = colors[Math.round(255 * field.position(values[i]))];
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

// One value at each pixel: what it is called, its colours, and how it is read.
class Field {
  constructor(described) {
    Object.assign(this, described);
    this.title = this.unit ? `${this.name}, ${this.unit}` : this.name;
  }

  async unpack() {
    this.values = await decimals(`field-${this.key}`, grid.width, this.digits);
  }

  // From the low to the high end, 0 to 1.
  share(value) {
    const { low, high } = this;
    const t = this.logarithmic ? Math.log(Math.max(value, low) / low) / Math.log(high / low) : (value - low) / (high - low);
    return Math.min(1, Math.max(0, t));
  }

  value(t) {
    const { low, high } = this;
    return this.logarithmic ? low * (high / low) ** t : low + t * (high - low);
  }

  // Along the colour map, and of heights.
  position(value) {
    return this.reversed ? 1 - this.share(value) : this.share(value);
  }

  text(value) {
    if (Number.isNaN(value)) return 'not valid';
    if (!Number.isFinite(value)) return value > 0 ? 'beyond' : '−beyond';
    return this.low < 0 ? signed(value, this.digits) : plain(value, this.digits);
  }

  // Round values between the ends, with their places and texts.
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

const fields = Object.fromEntries(data.fields.map((described) => [described.key, new Field(described)]));
// Where it has no value, the rest means little.
const [principal] = Object.values(fields);
const isValid = (i) => !Number.isNaN(principal.values[i]);

// With a true minus sign.
function plain(value, digits) {
  return (value < 0 ? '−' : '') + Math.abs(value).toFixed(digits);
}

// And with a plus where there is none.
function signed(value, digits) {
  return (value < 0 ? '−' : '+') + Math.abs(value).toFixed(digits);
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
