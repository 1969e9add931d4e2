// Steps and profiles with the pointer, computed like `parfocal measure` (src/metric/measure.rs,
// src/base/statistics.rs).

const median = (values) => {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.floor(sorted.length / 2)] : NaN;
};
const spread = (values) => 1.4826 * (median(values.map(Math.abs)) || 0);

// The values minus the slopes of a plane that is fitted to the inliers.
function withoutTilt(values, width) {
  const levelled = [...values];
  for (let round = 0; round < 5; round++) {
    const middle = median(levelled);
    const limit = 3 * spread(levelled.map((v) => v - middle));
    const kept = levelled.flatMap((v, i) => (Math.abs(v - middle) <= limit ? [[i % width, Math.floor(i / width), v - middle]] : []));
    const mean = (of) => kept.reduce((sum, k) => sum + of(k), 0) / kept.length;
    const [cx, cy] = [mean(([x]) => x), mean(([, y]) => y)];
    const [xx, yy, xy] = [mean(([x]) => (x - cx) ** 2), mean(([, y]) => (y - cy) ** 2), mean(([x, y]) => (x - cx) * (y - cy))];
    const [xv, yv] = [mean(([x, , v]) => (x - cx) * v), mean(([, y, v]) => (y - cy) * v)];
    const determinant = xx * yy - xy * xy;
    if (!(determinant >= 1e-6)) return levelled;
    const [right, down] = [(yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant];
    levelled.forEach((v, i) => { levelled[i] = v - right * ((i % width) - cx) - down * (Math.floor(i / width) - cy); });
  }
  return levelled;
}

// The number of values that carry as much information as one independent value.
function correlationArea(residuals, width) {
  const limit = 3 * spread(residuals);
  const clipped = residuals.map((r) => Math.min(limit, Math.max(-limit, r)));
  const product = (offset, along) => {
    let [sum, count] = [0, 0];
    for (let i = 0; i + offset < clipped.length; i++) {
      const both = clipped[i] * clipped[i + offset];
      if ((!along || (i % width) + offset < width) && Number.isFinite(both)) [sum, count] = [sum + both, count + 1];
    }
    return count ? sum / count : NaN;
  };
  const length = (size, at) => {
    const variance = at(0);
    if (!(variance > 0)) return 1;
    let sum = 0;
    for (let k = 1; k < size; k++) {
      const rho = at(k) / variance;
      if (!(rho > 0)) break;
      sum += rho;
    }
    return 1 + 2 * sum;
  };
  return length(width, (k) => product(k, true)) * length(Math.floor(residuals.length / width), (k) => product(k * width, false));
}

// The level of a rectangle, [x, y, width, height] in samples, and its standard error.
function level(values, [left, top, width, height]) {
  const inside = Array.from({ length: width * height }, (_, i) => values[(top + Math.floor(i / width)) * grid.width + left + (i % width)]);
  const count = inside.filter(Number.isFinite).length;
  if (count < 16) return null;
  const flat = withoutTilt(inside, width);
  const value = median(flat);
  const residuals = flat.map((v) => v - value);
  const independent = Math.max(1, count / correlationArea(residuals, width));
  return { value, error: Math.sqrt(Math.PI / 2 / independent) * spread(residuals) };
}

function step(values, [from, to]) {
  const [a, b] = [from, to].map((rectangle) => level(values, rectangle));
  return a && b ? { value: b.value - a.value, error: Math.hypot(a.error, b.error) } : null;
}

// Values along a line from sample to sample, bilinear, at most one apart.
function profile(values, [x1, y1, x2, y2]) {
  const last = Math.max(1, Math.ceil(Math.hypot(x2 - x1, y2 - y1)));
  const at = (i, j, weight) => (weight ? (i < grid.width && j < grid.height ? weight * values[j * grid.width + i] : NaN) : 0);
  return Array.from({ length: last + 1 }, (_, k) => {
    const [x, y] = [x1 + (k / last) * (x2 - x1), y1 + (k / last) * (y2 - y1)];
    const [i, j] = [Math.floor(x), Math.floor(y)];
    const [a, b] = [x - i, y - j];
    return at(i, j, (1 - a) * (1 - b)) + at(i + 1, j, a * (1 - b)) + at(i, j + 1, (1 - a) * b) + at(i + 1, j + 1, a * b);
  });
}

// The current tool: none, a line between two points, or the step between two rectangles.
const tool = {
  kind: null,
  line: null,
  rectangles: [],
  begun: null,

  choose(kind) {
    this.kind = this.kind === kind ? null : kind;
    this.begun = null;
    for (const button of byId('tools').querySelectorAll('[data-tool]')) button.setAttribute('aria-pressed', button.dataset.tool === this.kind);
    const hints = { line: 'Draw a line in either picture; or move the cursor and press Enter at both ends.', step: 'Draw two rectangles, one on each level; or press Enter at two corners of each.' };
    byId('tool-hint').textContent = hints[this.kind] ?? '';
    view.draw();
  },

  clear() {
    Object.assign(this, { line: null, rectangles: [], begun: null });
    this.show();
  },

  // The action of a drag that begins here; none if no tool is selected.
  start({ column, row }) {
    if (!this.kind) return null;
    const from = this.inside(column, row);
    return (place, isEnd) => this.stretch(from, this.inside(place.column, place.row), isEnd);
  },

  inside: (column, row) => [Math.min(grid.width - 1, Math.max(0, Math.floor(column))), Math.min(grid.height - 1, Math.max(0, Math.floor(row)))],

  // With the keyboard: the first corner, then the second.
  enter(x, y) {
    if (!this.kind) return;
    if (!this.begun) this.begun = [x, y];
    else {
      this.stretch(this.begun, [x, y], true);
      this.begun = null;
    }
    view.draw();
  },

  stretch([x1, y1], [x2, y2], isEnd) {
    const far = Math.hypot(x2 - x1, y2 - y1);
    if (this.kind === 'line') this.line = far >= 1 ? [x1, y1, x2, y2] : null;
    else {
      const rectangle = [Math.min(x1, x2), Math.min(y1, y2), Math.abs(x2 - x1) + 1, Math.abs(y2 - y1) + 1];
      if (!this.drawing) this.rectangles = [...this.rectangles.slice(this.rectangles.length > 1 ? 2 : 0), rectangle];
      else this.rectangles[this.rectangles.length - 1] = rectangle;
      this.drawing = !isEnd;
      if (isEnd && far < 1) this.rectangles.pop();
    }
    if (isEnd) this.show();
    else view.draw();
  },

  draw(context, pane) {
    const { ratio } = pane;
    const stroke = (path, number) => {
      for (const [color, width] of [['#000b', 4], ['#ffd23f', 2]]) {
        context.strokeStyle = color;
        context.lineWidth = width * ratio;
        context.stroke(path);
      }
      if (!number) return;
      context.font = `600 ${13 * ratio}px system-ui, sans-serif`;
      context.textBaseline = 'top';
      context.fillStyle = '#ffd23f';
      context.strokeStyle = '#000b';
      context.strokeText(number.text, ...number.at);
      context.fillText(number.text, ...number.at);
    };
    if (this.line) {
      const path = new Path2D();
      path.moveTo(...pane.at(this.line.slice(0, 2)));
      path.lineTo(...pane.at(this.line.slice(2)));
      stroke(path);
    }
    this.rectangles.forEach(([x, y, width, height], i) => {
      const [left, top] = pane.at([x - 0.5, y - 0.5]);
      const path = new Path2D();
      path.rect(left, top, width * pane.scale, height * pane.scale);
      stroke(path, { text: `${i + 1}`, at: [left + 4 * ratio, top + 4 * ratio] });
    });
    if (this.begun) {
      const path = new Path2D();
      path.arc(...pane.at(this.begun), 5 * ratio, 0, 2 * Math.PI);
      stroke(path);
    }
  },

  // In pixels of the results, for the command line.
  command() {
    const px = (sample) => pixelOf(sample);
    // The whole path, so that the command runs in any folder. A page from a server has no path here.
    const folders = decodeURIComponent(location.pathname).split('/').slice(0, -1);
    const path = location.protocol === 'file:' ? folders.join('/').replace(/^\/(?=[A-Za-z]:)/, '') : folders.at(-1);
    const out = path || 'OUT';
    const quoted = /^[\w./:-]+$/.test(out) ? out : `'${out.replaceAll("'", "'\\''")}'`;
    const parts = [`parfocal measure ${quoted}`];
    if (this.rectangles.length === 2) parts.push(`--step ${this.rectangles.map(([x, y, w, h]) => [px(x) - grid.first, px(y) - grid.first, w * grid.step, h * grid.step].join(',')).join(' ')}`);
    if (this.line) parts.push(`--profile ${this.line.map(px).join(',')}`);
    return parts.length > 1 ? parts.join(' ') : '';
  },

  // The result as text and as a curve.
  show() {
    view?.draw();
    const lines = [];
    const known = ({ value, error }, field) => `${withDeviation(value, error, { ...field, text: (v) => field.text(v), low: -1, digits: 6 })} ${field.unit}`;
    if (this.rectangles.length === 2) {
      const found = [main, ...(main === principal ? [] : [principal])].map((field) => [field, step(field.values, this.rectangles)]);
      lines.push(`Step from 1 to 2: ${found.map(([field, of]) => (of ? known(of, field) : 'too few pixels are measured')).join(', ')}`);
    }
    byId('curve-title').hidden = byId('profile').hidden = !this.line;
    if (this.line) {
      const [values, sigmas] = [main, sureness].map((field) => profile(field.values, this.line));
      const ends = [values.find(Number.isFinite), values.findLast(Number.isFinite)];
      const length = Math.hypot(this.line[2] - this.line[0], this.line[3] - this.line[1]) * grid.step;
      const sigma = Math.hypot(sigmas.find(Number.isFinite), sigmas.findLast(Number.isFinite));
      const size = report.pixel_size_um ? ` (${significant((length * report.pixel_size_um) / 1000, 4)} mm)` : '';
      lines.push(`Profile over ${plain(length, 1)} px${size}: from end to end ${ends[0] === undefined ? 'not measured' : known({ value: ends[1] - ends[0], error: sigma }, main)}`);
      byId('profile').replaceChildren(profilePlot(byId('profile').clientWidth || 600, values, sigmas, length));
    }
    byId('measure-panel').hidden = !lines.length;
    byId('measured-text').replaceChildren(...lines.map((text) => element('p', {}, text)));
    byId('command').textContent = this.command();
  },
};

// A curve with its standard deviation to both sides.
function profilePlot(width, values, sigmas, length) {
  const known = values.map((v, i) => [(i / (values.length - 1)) * length, v, Number.isFinite(sigmas[i]) ? sigmas[i] : 0]).filter(([, v]) => Number.isFinite(v));
  const low = Math.min(...known.map(([, v, s]) => v - s));
  const high = Math.max(...known.map(([, v, s]) => v + s));
  return chart({ width, height: 200, x: [0, length], y: [low, high], label: `Profile of ${main.name.toLowerCase()}`, xTitle: 'px along the line', yTitle: main.title }, (at) => {
    const edge = (sign) => known.map(([d, v, s]) => at(d, v + sign * s).join(','));
    return known.length ? [svg('polygon', { class: 'deviation', points: [...edge(1), ...edge(-1).reverse()].join(' ') }), svg('polyline', { class: 'curve', points: known.map(([d, v]) => at(d, v).join(',')).join(' ') })] : [];
  });
}
