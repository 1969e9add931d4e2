// Plots, as SVG.

function element(name, attributes = {}, ...children) {
  const found = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  found.append(...children);
  return found;
}

function svg(name, attributes, text) {
  const found = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  if (text !== undefined) found.textContent = text;
  return found;
}

// Axes with round ticks. `marks(at)` draws at positions in the units of both axes.
function chart({ width, height, x: [x1, x2], y: [y1, y2], label, xTitle, yTitle }, marks) {
  const [left, right, top, bottom] = [62, 10, 22, 38];
  const picture = svg('svg', { viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': label });
  const pad = 0.06 * (y2 - y1 || Math.abs(y1) || 1);
  const [low, high] = [y1 - pad, y2 + pad];
  const at = (x, y) => [left + ((x - x1) / (x2 - x1 || 1)) * (width - left - right), top + ((high - y) / (high - low)) * (height - top - bottom)];
  if (![low, high].every(Number.isFinite)) {
    picture.append(svg('text', { x: 8, y: 24 }, 'Nothing is measured here.'));
    return picture;
  }
  const vertical = roundTicks(low, high, 5);
  for (const tick of vertical.ticks) {
    const [, y] = at(x1, tick);
    picture.append(svg('line', { class: 'grid', x1: left, x2: width - right, y1: y, y2: y }));
    picture.append(svg('text', { x: left - 8, y: y + 4, 'text-anchor': 'end' }, plain(tick, vertical.digits)));
  }
  const across = roundTicks(x1, x2, Math.max(3, width / 110));
  for (const tick of across.ticks) picture.append(svg('text', { x: at(tick, low)[0], y: height - bottom + 16, 'text-anchor': 'middle' }, plain(tick, across.digits)));
  picture.append(...marks(at));
  picture.append(svg('text', { x: (left + width - right) / 2, y: height - 4, 'text-anchor': 'middle' }, xTitle));
  picture.append(svg('text', { x: 4, y: 13 }, yTitle));
  return picture;
}

// One curve per level, coarse to fine, side by side: the energies of different levels are not comparable.
function energyPlot(width) {
  const all = report.levels.flatMap((level) => level.energy).filter((e) => e !== null);
  const count = report.levels.reduce((sum, level) => sum + level.energy.length, 0);
  const [least, most] = all.length ? [Math.min(...all), Math.max(...all)] : [NaN, NaN];
  return chart({ width, height: 250, x: [-0.5, count - 0.5], y: [least, most], label: 'Energy per valid pixel by outer iteration',
    xTitle: 'outer iteration, levels from coarse to fine', yTitle: 'energy per valid pixel' }, (at) => {
    let start = 0;
    return report.levels.flatMap((level) => {
      const points = level.energy.flatMap((e, i) => (e === null ? [] : [[start + i, e]]));
      start += level.energy.length;
      const curve = svg('polyline', { class: 'curve', points: points.map(([i, e]) => at(i, e).join(',')).join(' ') });
      curve.append(svg('title', {}, `level ${level.width} × ${level.height} px`));
      return [curve, ...points.map(([i, e]) => svg('circle', { class: 'dot', cx: at(i, e)[0], cy: at(i, e)[1], r: 2.5 }))];
    });
  });
}

// For a sweep: the sharpness of each frame around a sample, by the variance of its Laplacian, and that of the model.
class FocusCurve {
  constructor(pictures) {
    this.frames = pictures.slice(0, data.frames);
    // The scale of the smallest picture. The pictures of a long sweep are reduced, but not that of the reference.
    this.factor = Math.min(...this.frames.map((picture) => picture.width)) / grid.width;
    this.plot = byId('focus-curve');
  }

  // The window has 13 x 13 px, or at least 7 x 7 px of the smallest picture. All pictures are drawn at its scale, since
  // what is sharp in a reduced picture is not as sharp in a whole one.
  sharpness(picture, x, y) {
    const { factor } = this;
    const reach = Math.max(3, Math.round(6 * factor));
    const side = 2 * reach + 3;
    const ratio = picture.width / (grid.width * factor);
    const context = canvasOf(side, side).getContext('2d', { willReadFrequently: true });
    context.imageSmoothingQuality = 'high';
    const corner = [x, y].map((v) => ratio * (Math.round(v * factor) - reach - 1));
    context.drawImage(picture, ...corner, ratio * side, ratio * side, 0, 0, side, side);
    const { data: bytes } = context.getImageData(0, 0, side, side);
    const gray = (i, j) => bytes[4 * (j * side + i)] + bytes[4 * (j * side + i) + 1] + bytes[4 * (j * side + i) + 2];
    const found = [];
    for (let j = 1; j < side - 1; j++) for (let i = 1; i < side - 1; i++) found.push(4 * gray(i, j) - gray(i - 1, j) - gray(i + 1, j) - gray(i, j - 1) - gray(i, j + 1));
    const mean = found.reduce((sum, v) => sum + v, 0) / found.length;
    return found.reduce((sum, v) => sum + (v - mean) ** 2, 0) / found.length;
  }

  show(at) {
    const [x, y] = [at % grid.width, Math.floor(at / grid.width)];
    const settings = report.frames.map((frame) => frame.position);
    const measured = this.frames.map((picture) => this.sharpness(picture, x + 0.5, y + 0.5));
    const most = Math.max(...measured, 1e-9);
    const [u, sigma] = [principal.values[at], fields.uncertainty.values[at]];
    const ends = [Math.min(...settings), Math.max(...settings)];
    const winner = measured.indexOf(Math.max(...measured));
    // Texture of about a pixel. Its blur variance grows by the rate with the squared distance from the focus.
    const model = (p) => (1 + report.blur_rate_px2 * (p - u) ** 2) ** -2;
    const plot = chart({ width: this.plot.clientWidth || 600, height: 220, x: ends, y: [0, 1], label: 'Sharpness of each frame at the cursor',
      xTitle: `setting${report.focus_unit === 'settings' ? '' : `, ${report.focus_unit}`}`, yTitle: 'sharpness, of the greatest' }, (place) => {
      const marks = settings.map((p, n) => {
        const [cx, cy] = place(p, measured[n] / most);
        const dot = svg('circle', { class: n === winner ? 'dot wins' : 'dot', cx, cy, r: n === winner ? 6 : 3.5 });
        dot.append(svg('title', {}, `${data.pictures[n]}: ${plain(measured[n] / most, 2)}`));
        return dot;
      });
      if (Number.isNaN(u)) return marks;
      const curve = Array.from({ length: 101 }, (_, i) => ends[0] + ((ends[1] - ends[0]) * i) / 100).map((p) => place(p, model(p)).join(','));
      const [[left], [right], [middle, foot]] = [place(Math.max(ends[0], u - sigma), 0), place(Math.min(ends[1], u + sigma), 0), place(u, 0)];
      const head = place(u, 1)[1];
      return [svg('rect', { class: 'deviation', x: left, y: head, width: Math.max(1, right - left), height: foot - head }), svg('polyline', { class: 'model', points: curve.join(' ') }),
        svg('line', { class: 'focus', x1: middle, x2: middle, y1: head, y2: foot }), ...marks];
    });
    this.plot.replaceChildren(plot);
    const inFocus = Number.isNaN(u) ? 'No pair of frames determines its focus.' : `In focus at ${withDeviation(u, sigma, principal)} ${principal.unit}.`;
    byId('focus-note').textContent = `At ${pixelOf(x)}, ${pixelOf(y)}: ${data.pictures[winner]} is the sharpest. ${inFocus}`;
  }
}
