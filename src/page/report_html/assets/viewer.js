// The two panes: photographs, and maps of depth and uncertainty.

const explanations = {
  compare: 'Each photograph lies on the reference’s pixels by the transform found, with gain and offset. What jumps is not registered; '
    + 'what only changes sharpness is.',
  frames: 'The frames on the pixels of the reference, one after the other: sharpness wanders through the scene, and nothing else should '
    + 'move. Many frames are reduced in size.',
  difference: '|left − right| × 4. Edges that are left everywhere mean that the registration is off, edges that come and go with depth are blur.',
  fused: isPair ? 'Of each pixel the sharper photograph.' : 'Each pixel from the frames focused nearest to where it is sharp.',
};

class PhotoPane extends Pane {
  // The pictures with the names of `data.pictures`; the fused image is last.
  constructor(pictures, view) {
    super('stage', view);
    Object.assign(this, { pictures, mode: 'fused', split: 0.5, sides: [...data.compare], frame: data.compare[0], layers: {} });
    const own = [['fused', 'Best focus'], ['compare', 'Compare'], ...(data.frames ? [['frames', 'Frames']] : []), ['difference', 'Difference']];
    byId('photographs').append(...own.map(([mode, text]) => element('button', { type: 'button', 'data-mode': mode }, text)));
    for (const id of ['left', 'right']) byId(id).append(...data.pictures.map((name, i) => new Option(name, i)));
    [byId('left').value, byId('right').value] = data.compare;
    byId('frame').max = (data.frames ?? 1) - 1;
    byId('frame').value = this.frame;
    this.controls();
    this.show('fused');
  }

  controls() {
    byId('photographs').addEventListener('click', (event) => event.target.dataset.mode && this.show(event.target.dataset.mode));
    byId('split').addEventListener('input', (event) => this.setSplit(event.target.value / 1000));
    byId('sides').addEventListener('change', () => {
      this.sides = ['left', 'right'].map((id) => Number(byId(id).value));
      this.show(this.mode);
    });
    byId('frame').addEventListener('input', (event) => {
      this.frame = Number(event.target.value);
      this.tag();
      this.draw();
    });
    byId('flicker').addEventListener('click', () => { this.flicker(!this.timer); this.draw(); });
  }

  show(mode) {
    this.mode = mode;
    for (const button of byId('photographs').children) button.setAttribute('aria-pressed', button.dataset.mode === mode);
    byId('split-control').hidden = byId('flicker').hidden = mode !== 'compare';
    byId('sides').hidden = mode !== 'compare' && mode !== 'difference';
    byId('frame-control').hidden = mode !== 'frames';
    byId('photo-note').textContent = explanations[mode];
    this.flicker(false);
    this.tag();
    this.draw();
  }

  // The name of the content, in a fixed corner of the picture.
  tag() {
    const shown = { compare: this.sides, frames: [this.frame] }[this.mode] ?? [];
    const of = (i) => {
      const frame = this.mode === 'frames' && report.frames[i];
      return i === undefined ? '' : data.pictures[i] + (frame ? ` · setting ${Number(frame.position.toPrecision(6))}` : '');
    };
    [byId('tag-1').textContent, byId('tag-2').textContent] = [of(shown[0]), of(shown[1])];
  }

  difference() {
    const [a, b] = this.sides.map((i) => {
      const context = canvasOf(grid.width, grid.height).getContext('2d', { willReadFrequently: true });
      context.drawImage(this.pictures[i], 0, 0, grid.width, grid.height);
      return context.getImageData(0, 0, grid.width, grid.height);
    });
    for (let i = 0; i < a.data.length; i += 4) {
      // A photograph may not cover the rest.
      const valid = isValid(i / 4);
      for (let c = 0; c < 3; c++) a.data[i + c] = valid ? Math.min(255, 4 * Math.abs(a.data[i + c] - b.data[i + c])) : 0;
    }
    const canvas = canvasOf(grid.width, grid.height);
    canvas.getContext('2d').putImageData(a, 0, 0);
    return canvas;
  }

  picture() {
    if (this.mode === 'fused') return this.pictures.at(-1);
    if (this.mode === 'frames') return this.pictures[this.frame];
    return (this.layers[this.sides] ??= this.difference());
  }

  paint(context) {
    if (this.mode === 'compare') this.paintPair(context);
    else if (this.mode) context.drawImage(this.picture(), 0, 0, grid.width, grid.height);
  }

  paintPair(context) {
    const paint = (i) => context.drawImage(this.pictures[i], 0, 0, grid.width, grid.height);
    if (this.timer) return paint(this.second ? this.sides[1] : this.sides[0]);
    paint(this.sides[1]);
    const seam = this.split * grid.width;
    context.save();
    context.beginPath();
    context.rect(0, 0, seam, grid.height);
    context.clip();
    paint(this.sides[0]);
    context.restore();
    context.setTransform(1, 0, 0, 1, 0, 0);
    const x = this.left + this.scale * seam;
    const middle = this.canvas.height / 2;
    const r = this.ratio;
    context.fillStyle = '#fff';
    context.strokeStyle = '#0008';
    context.lineWidth = r;
    context.fillRect(x - r, 0, 2 * r, this.canvas.height);
    context.beginPath();
    context.arc(x, middle, 15 * r, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    context.fillStyle = '#333';
    for (const side of [-1, 1]) {
      context.beginPath();
      context.moveTo(x + side * 10 * r, middle);
      context.lineTo(x + side * 4 * r, middle - 5 * r);
      context.lineTo(x + side * 4 * r, middle + 5 * r);
      context.fill();
    }
  }

  // The handle of the seam.
  grab({ x, column }) {
    const seam = this.left + this.scale * this.split * grid.width;
    if (this.mode !== 'compare' || this.timer || Math.abs(x - seam) > 22 * this.ratio) return null;
    this.setSplit(column / grid.width);
    return (place) => this.setSplit(place.column / grid.width);
  }

  setSplit(split) {
    this.split = Math.min(1, Math.max(0, split));
    byId('split').value = Math.round(1000 * this.split);
    this.flicker(false);
    this.draw();
  }

  flicker(on) {
    clearInterval(this.timer);
    this.timer = on ? setInterval(() => this.flip(), 500) : null;
    byId('flicker').setAttribute('aria-pressed', on);
    byId('tag-1').hidden = byId('tag-2').hidden = false;
    if (on) this.flip();
  }

  flip() {
    this.second = !this.second;
    byId('tag-1').hidden = this.second;
    byId('tag-2').hidden = !this.second;
    this.draw();
  }
}

class MapPane extends Pane {
  constructor(view) {
    super('map', view);
    Object.assign(this, { layers: {}, colormaps: Object.fromEntries(Object.values(fields).map((f) => [f.key, f.gray ? data.colormaps.length - 1 : data.colormap])) });
    const button = (f) => element('button', { type: 'button', 'data-mode': f.key }, f.name);
    const all = Object.values(fields);
    byId('depths').append(...[main, ...all.filter((f) => f !== main && !TRUST.includes(f.key))].map(button));
    byId('trusts').append(...all.filter((f) => TRUST.includes(f.key)).map(button));
    const number = (f) => element('b', { id: `at-${f.key}` }, '–');
    byId('readout').append(...all.map((f) => element('span', {}, element('i', {}, f.sign), ' ', number(f), ` ${f.unit}`)));
    byId('colors').append(...data.colormaps.map((map, i) => new Option(map.name, i)));
    this.controls();
    this.show(main.key);
  }

  controls() {
    for (const id of ['depths', 'trusts']) byId(id).addEventListener('click', (event) => event.target.dataset.mode && this.show(event.target.dataset.mode));
    byId('colors').addEventListener('change', (event) => {
      this.colormaps[this.mode] = Number(event.target.value);
      this.show(this.mode);
    });
    // Equal steps of the logarithm, from the least uncertain pixels to all pixels.
    const [low, high] = quantiles(sureness.values, [0.02, 0.995], (i) => isValid(i)).map((v) => Math.max(v ?? 1, 1e-9));
    this.sigmas = (position) => (position >= 1000 ? Infinity : low * (Math.max(high, 1.01 * low) / low) ** (position / 1000));
    byId('sigma').addEventListener('input', (event) => this.setThreshold(Number(event.target.value)));
    this.setThreshold(1000);
  }

  // Hatches the more uncertain pixels.
  setThreshold(position) {
    threshold = this.sigmas(position);
    byId('sigma').value = position;
    const most = Number.isFinite(threshold) ? `${significant(threshold, 2)} ${sureness.unit}` : 'off';
    byId('sigma-value').value = `${most} · ${plain(100 * measuredShare(), 0)} % measured`;
    byId('sigma').setAttribute('aria-valuetext', most);
    this.layers = {};
    this.draw();
  }

  show(mode) {
    this.mode = mode;
    for (const button of document.querySelectorAll('#depths button, #trusts button')) button.setAttribute('aria-pressed', button.dataset.mode === mode);
    const field = fields[mode];
    byId('map-title').textContent = field.title;
    byId('map-note').textContent = field.note;
    byId('colors').value = this.colormaps[mode];
    this.legend(field);
    this.draw();
  }

  // The key to the colours, with values increasing to the right.
  legend(field) {
    const context = byId('ramp').getContext('2d');
    const colors = colorsOf(data.colormaps[this.colormaps[field.key]]);
    for (let i = 0; i < 256; i++) {
      const [r, g, b] = colors[Math.round(255 * field.position(field.value((i + 0.5) / 256)))];
      context.fillStyle = `rgb(${r} ${g} ${b})`;
      context.fillRect(i, 0, 1, 1);
    }
    [byId('scale-low').textContent, byId('scale-high').textContent] = field.ends;
    byId('ticks').replaceChildren();
    field.ticks(6).forEach(({ text, at }, i, all) => {
      const label = element('span', {}, i === all.length - 1 ? `${text} ${field.unit}` : text);
      label.style.left = `${100 * at}%`;
      byId('ticks').append(label);
    });
  }

  // The picture of a field, computed on first use.
  layer(key) {
    const map = this.colormaps[key];
    const hatched = TRUST.includes(key) ? () => false : isUnsure;
    const under = fields[key] === main ? filled?.values : null;
    return (this.layers[`${key} ${map}`] ??= colored(fields[key].values, data.colormaps[map], fields[key], hatched, under));
  }

  paint(context) {
    if (this.mode) context.drawImage(this.layer(this.mode), 0, 0, grid.width, grid.height);
  }

  // A picture with its key below, at the size of the data.
  png() {
    const map = this.layer(this.mode);
    const [field, unit] = [fields[this.mode], Math.max(1, Math.round(map.width / 640))];
    const canvas = canvasOf(map.width, map.height + 56 * unit);
    const context = canvas.getContext('2d');
    context.fillStyle = '#fff';
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(map, 0, 0);
    const [left, width, top] = [60 * unit, map.width - 120 * unit, map.height + 12 * unit];
    context.drawImage(byId('ramp'), left, top, width, 14 * unit);
    context.fillStyle = '#222';
    context.font = `${12 * unit}px system-ui, sans-serif`;
    context.textAlign = 'center';
    field.ticks(6).forEach(({ text, at }) => context.fillText(text, left + at * width, top + 30 * unit));
    context.fillText(field.title, map.width / 2, top + 44 * unit);
    context.fillText(field.ends[0], left / 2, top + 12 * unit);
    context.fillText(field.ends[1], map.width - left / 2, top + 12 * unit);
    return canvas;
  }
}
