// The pictures: one canvas, in which a cursor reads the fields.

// Grid coordinates run over samples; sample k stands for pixel first + k step of I1.
const pixelOf = (sample) => grid.first + sample * grid.step;

const explanations = {
  compare: 'Each photograph lies on the reference’s pixels by the transform found, with gain and offset. What jumps is not registered; '
    + 'what only changes sharpness is.',
  frames: 'The frames on the pixels of the reference, one after the other: sharpness wanders through the scene, and nothing else should '
    + 'move. Many frames are reduced in size.',
  difference: '|left − right| × 4. Edges that are left everywhere mean that the registration is off, edges that come and go with depth are blur.',
  fused: isPair ? 'Of each pixel the sharper photograph.' : 'Each pixel from the frames focused nearest to where it is sharp.',
};

class Viewer {
  // Pictures as `data.pictures` names them, the fused one last.
  constructor(pictures) {
    Object.assign(this, { pictures, canvas: byId('stage'), mode: 'compare', split: 0.5, cursor: null, held: false });
    this.sides = [...data.compare];
    this.context = this.canvas.getContext('2d');
    this.colormaps = Object.fromEntries(Object.values(fields).map((f) => [f.key, f.gray ? data.colormaps.length - 1 : data.colormap]));
    this.frame = data.compare[0];
    this.layers = {};
    this.build();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
    this.show('compare');
  }

  // A button and a number for each field, and what depends on how many pictures there are.
  build() {
    const button = (mode, text) => element('button', { type: 'button', 'data-mode': mode }, text);
    const own = [['compare', 'Compare'], ...(data.frames ? [['frames', 'Frames']] : []), ['difference', 'Difference'], ['fused', 'Best focus']];
    byId('modes').append(...own.map(([mode, text]) => button(mode, text)), ...Object.values(fields).map((f) => button(f.key, f.name)));
    const number = (f) => element('b', { id: `at-${f.key}` }, '–');
    byId('readout').append(...Object.values(fields).map((f) => element('span', {}, element('i', {}, f.sign), ' ', number(f), ` ${f.unit}`)));
    for (const id of ['left', 'right']) byId(id).append(...data.pictures.map((name, i) => new Option(name, i)));
    [byId('left').value, byId('right').value] = data.compare;
    byId('frame').max = (data.frames ?? 1) - 1;
    byId('frame').value = this.frame;
  }

  resize() {
    const fitted = this.fitted ?? true;
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * this.ratio));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * this.ratio));
    if (fitted) this.fit();
    else this.draw();
  }

  fitScale() {
    return Math.min(this.canvas.width / grid.width, this.canvas.height / grid.height);
  }

  fit() {
    this.scale = this.fitScale();
    this.left = (this.canvas.width - this.scale * grid.width) / 2;
    this.top = (this.canvas.height - this.scale * grid.height) / 2;
    this.moved(true);
  }

  // So that the sample at (x, y) of the canvas stays there.
  zoom(factor, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    const scale = Math.min(64 * this.ratio, Math.max(this.fitScale(), this.scale * factor));
    if (scale <= this.fitScale() * 1.001) return this.fit();
    this.left = x - ((x - this.left) * scale) / this.scale;
    this.top = y - ((y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.moved(false);
  }

  moved(fitted) {
    this.fitted = fitted;
    // No further than the edge, or the middle where all of a side is seen.
    const held = (start, shown, whole) => (whole <= shown ? (shown - whole) / 2 : Math.min(0, Math.max(shown - whole, start)));
    this.left = held(this.left, this.canvas.width, this.scale * grid.width);
    this.top = held(this.top, this.canvas.height, this.scale * grid.height);
    byId('zoom').value = `${Math.round((100 * this.scale) / this.ratio / grid.step)} %`;
    this.canvas.style.touchAction = fitted ? 'pan-y' : 'none';
    this.draw();
  }

  show(mode) {
    this.mode = mode;
    for (const button of byId('modes').children) button.setAttribute('aria-pressed', button.dataset.mode === mode);
    const field = fields[mode];
    byId('scale').hidden = !field;
    byId('colors-control').hidden = !field;
    byId('split-control').hidden = byId('flicker').hidden = mode !== 'compare';
    byId('sides').hidden = mode !== 'compare' && mode !== 'difference';
    byId('frame-control').hidden = mode !== 'frames';
    byId('explanation').textContent = field ? field.note : explanations[mode];
    this.flicker(false);
    this.tag();
    if (field) {
      byId('colors').value = this.colormaps[mode];
      this.key(field);
    }
    this.draw();
  }

  // What is seen where.
  tag() {
    const shown = { compare: this.sides, frames: [this.frame] }[this.mode] ?? [];
    const of = (i) => {
      const frame = this.mode === 'frames' && report.frames[i];
      return i === undefined ? '' : data.pictures[i] + (frame ? ` · setting ${Number(frame.position.toPrecision(6))}` : '');
    };
    [byId('tag-1').textContent, byId('tag-2').textContent] = [of(shown[0]), of(shown[1])];
  }

  // The key to the colours, values rising to the right.
  key(field) {
    const context = byId('ramp').getContext('2d');
    const colors = colorsOf(data.colormaps[this.colormaps[this.mode]]);
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

  // The picture of a mode, made when it is first asked for.
  layer(mode) {
    if (mode === 'fused') return this.pictures.at(-1);
    if (mode === 'frames') return this.pictures[this.frame];
    const map = this.colormaps[mode];
    const field = fields[mode];
    const name = field ? `${mode} ${map}` : `${mode} ${this.sides}`;
    return (this.layers[name] ??= field ? colored(field.values, data.colormaps[map], field) : this.difference());
  }

  difference() {
    const [a, b] = this.sides.map((i) => {
      const context = canvasOf(grid.width, grid.height).getContext('2d', { willReadFrequently: true });
      context.drawImage(this.pictures[i], 0, 0, grid.width, grid.height);
      return context.getImageData(0, 0, grid.width, grid.height);
    });
    for (let i = 0; i < a.data.length; i += 4) {
      // Elsewhere a photograph may not reach.
      const valid = isValid(i / 4);
      for (let c = 0; c < 3; c++) a.data[i + c] = valid ? Math.min(255, 4 * Math.abs(a.data[i + c] - b.data[i + c])) : 0;
    }
    const canvas = canvasOf(grid.width, grid.height);
    canvas.getContext('2d').putImageData(a, 0, 0);
    return canvas;
  }

  draw() {
    const { context, canvas } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.setTransform(this.scale, 0, 0, this.scale, this.left, this.top);
    // Enlarged, pixels are seen as they are.
    context.imageSmoothingEnabled = this.scale < 3 * this.ratio;
    context.imageSmoothingQuality = 'high';
    if (this.mode === 'compare') this.drawPair();
    else context.drawImage(this.layer(this.mode), 0, 0, grid.width, grid.height);
    this.drawCursor();
  }

  drawPair() {
    const { context } = this;
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

  drawCursor() {
    if (!this.cursor) return;
    const { context, ratio } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    const x = this.left + this.scale * (this.cursor[0] + 0.5);
    const y = this.top + this.scale * (this.cursor[1] + 0.5);
    const gap = Math.max(4 * ratio, this.scale * 0.75);
    for (const [color, width] of [['#000a', 3], ['#fff', 1.25]]) {
      context.strokeStyle = color;
      context.lineWidth = width * ratio;
      context.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        context.moveTo(x + dx * gap, y + dy * gap);
        context.lineTo(x + dx * (gap + 8 * ratio), y + dy * (gap + 8 * ratio));
      }
      context.stroke();
    }
  }

  // Reads the fields at a sample.
  point(x, y) {
    this.cursor = [Math.min(grid.width - 1, Math.max(0, x)), Math.min(grid.height - 1, Math.max(0, y))];
    const at = this.cursor[1] * grid.width + this.cursor[0];
    byId('at-x').textContent = pixelOf(this.cursor[0]);
    byId('at-y').textContent = pixelOf(this.cursor[1]);
    for (const field of Object.values(fields)) byId(`at-${field.key}`).textContent = field.text(field.values[at]);
    this.draw();
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

  // Of an event: where in the canvas, and which sample.
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio];
    return { x, y, column: (x - this.left) / this.scale, row: (y - this.top) / this.scale };
  }

  read(event) {
    const { column, row } = this.place(event);
    if (column >= 0 && row >= 0 && column < grid.width && row < grid.height) this.point(Math.floor(column), Math.floor(row));
  }

  listen() {
    const { canvas } = this;
    let drag = null;
    canvas.addEventListener('pointerdown', (event) => {
      const { x, y, column } = this.place(event);
      const seam = this.left + this.scale * this.split * grid.width;
      const sliding = this.mode === 'compare' && !this.timer && Math.abs(x - seam) < 20 * this.ratio;
      drag = { x, y, left: this.left, top: this.top, sliding, far: false };
      canvas.setPointerCapture(event.pointerId);
      if (sliding) this.setSplit(column / grid.width);
    });
    canvas.addEventListener('pointermove', (event) => {
      const { x, y, column } = this.place(event);
      if (!drag && !this.held) this.read(event);
      if (!drag) return;
      drag.far ||= Math.hypot(x - drag.x, y - drag.y) > 4 * this.ratio;
      if (drag.sliding) return this.setSplit(column / grid.width);
      if (!drag.far || this.fitted) return;
      [this.left, this.top] = [drag.left + x - drag.x, drag.top + y - drag.y];
      this.moved(false);
    });
    canvas.addEventListener('pointerup', (event) => {
      if (drag && !drag.far && !drag.sliding) {
        this.held = event.pointerType === 'mouse' && !this.held;
        this.read(event);
      }
      drag = null;
    });
    canvas.addEventListener('pointercancel', () => { drag = null; });
    canvas.addEventListener('wheel', (event) => {
      // The page scrolls until the picture has been chosen.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      const { x, y } = this.place(event);
      this.zoom(Math.exp(-event.deltaY / 400), x, y);
    }, { passive: false });
    canvas.addEventListener('keydown', (event) => this.key_(event));
    byId('modes').addEventListener('click', (event) => event.target.dataset.mode && this.show(event.target.dataset.mode));
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
    byId('zoom-in').addEventListener('click', () => this.zoom(1.5));
    byId('zoom-out').addEventListener('click', () => this.zoom(1 / 1.5));
    byId('fit').addEventListener('click', () => this.fit());
    byId('actual').addEventListener('click', () => this.zoom((grid.step * this.ratio) / this.scale));
    byId('colors').append(...data.colormaps.map((map, i) => new Option(map.name, i)));
    byId('colors').addEventListener('change', (event) => {
      this.colormaps[this.mode] = Number(event.target.value);
      this.key(fields[this.mode]);
      this.draw();
    });
  }

  key_(event) {
    const step = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const [x, y] = this.cursor ?? [Math.floor(grid.width / 2), Math.floor(grid.height / 2)];
    const move = moves[event.key];
    if (move) {
      this.held = true;
      this.point(x + move[0], y + move[1]);
    } else if (event.key === '+' || event.key === '=') this.zoom(1.5, this.left + this.scale * x, this.top + this.scale * y);
    else if (event.key === '-') this.zoom(1 / 1.5);
    else if (event.key === '0') this.fit();
    else return;
    event.preventDefault();
  }
}
