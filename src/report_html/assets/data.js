// What the page holds, unpacked.

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId('data').textContent);
const { grid, report } = data;

function bytes(id) {
  const text = atob(byId(id).textContent);
  const found = new Uint8Array(text.length);
  for (let i = 0; i < found.length; i++) found[i] = text.charCodeAt(i);
  return found;
}

// Floats as packed.rs packs them: zlib, four planes of bytes, differences of the bits.
async function floats(id) {
  const stream = new Blob([bytes(id)]).stream().pipeThrough(new DecompressionStream('deflate'));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 4;
  const bits = new Uint32Array(count);
  for (let i = 0, before = 0; i < count; i++) {
    const difference = planes[i] | (planes[count + i] << 8) | (planes[2 * count + i] << 16) | (planes[3 * count + i] << 24);
    before = (before + difference) >>> 0;
    bits[i] = before;
  }
  return new Float32Array(bits.buffer);
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

// A field as a picture; nothing where it is not valid.
function colored(values, valid, map, field) {
  const canvas = canvasOf(grid.width, grid.height);
  const context = canvas.getContext('2d');
  const image = context.createImageData(grid.width, grid.height);
  const colors = colorsOf(map);
  for (let i = 0; i < values.length; i++) {
    if (!valid(i)) continue;
    const [r, g, b] = colors[Math.round(255 * Math.min(1, Math.max(0, field.position(values[i]))))];
    image.data.set([r, g, b, 255], 4 * i);
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

// What the colours of a field mean.
const fields = {
  relative_blur: {
    low: data.relative_blur.low,
    high: data.relative_blur.high,
    ends: report.nearer === 1 ? ['far', 'near'] : ['near', 'far'],
    unit: 'px²',
    // Nearness.
    position(v) {
      const t = (v - this.low) / (this.high - this.low);
      return report.nearer === 1 ? t : 1 - t;
    },
    value(t) { return this.low + t * (this.high - this.low); },
    text: (v) => (Number.isNaN(v) ? 'not valid' : signed(v, 4)),
  },
  confidence: {
    low: data.confidence.low,
    high: data.confidence.high,
    ends: ['unsure', 'sure'],
    unit: '',
    logarithmic: true,
    position(c) { return Math.log(Math.max(c, this.low) / this.low) / Math.log(this.high / this.low); },
    value(t) { return this.low * (this.high / this.low) ** t; },
    text: (c) => c.toPrecision(4),
  },
};

// With a true minus sign, and a plus where there is none.
function signed(value, digits) {
  return (value < 0 ? '−' : '+') + Math.abs(value).toFixed(digits);
}

// Ticks at round values between two, about `count` of them.
function roundTicks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high * (1 + 1e-9); k++) ticks.push(k * step);
  return { ticks, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}
