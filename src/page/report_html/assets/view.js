// Two pictures with a shared view: the visible part of the image, and the pixel that is read.

// Grid coordinates count samples. Sample k is pixel first + k step of I1.
const pixelOf = (sample) => grid.first + sample * grid.step;

// The state that all panes share. `zoom` is 1 if all is visible; the position of the middle is in samples.
class View {
  constructor() {
    Object.assign(this, { zoom: 1, x: grid.width / 2, y: grid.height / 2, cursor: null, held: false, panes: [], watchers: [] });
  }

  get fitted() {
    return this.zoom <= 1.001;
  }

  // Redraws all panes, or only their overlays if nothing else has changed.
  draw() {
    for (const pane of this.panes) pane.draw();
  }

  moved() {
    const kept = (at, size) => Math.min(size - size / 2 / this.zoom, Math.max(size / 2 / this.zoom, at));
    if (this.fitted) Object.assign(this, { zoom: 1, x: grid.width / 2, y: grid.height / 2 });
    else [this.x, this.y] = [kept(this.x, grid.width), kept(this.y, grid.height)];
    byId('zoom').value = `${Math.round((100 * this.panes[0].scale) / this.panes[0].ratio / grid.step)} %`;
    this.draw();
  }

  // Keeps a sample in its position.
  zoomBy(factor, [x, y] = this.cursor ?? [this.x, this.y]) {
    const zoom = Math.min(200, Math.max(1, this.zoom * factor));
    [this.x, this.y] = [x + ((this.x - x) * this.zoom) / zoom, y + ((this.y - y) * this.zoom) / zoom];
    this.zoom = zoom;
    this.moved();
  }

  fit() {
    this.zoom = 1;
    this.moved();
  }

  // Reads the fields at a sample.
  point(x, y) {
    this.cursor = [Math.min(grid.width - 1, Math.max(0, x)), Math.min(grid.height - 1, Math.max(0, y))];
    const at = this.cursor[1] * grid.width + this.cursor[0];
    byId('at-x').textContent = pixelOf(this.cursor[0]);
    byId('at-y').textContent = pixelOf(this.cursor[1]);
    for (const field of Object.values(fields)) byId(`at-${field.key}`).textContent = field.text(field.values[at]);
    this.draw();
    for (const watch of this.watchers) watch(at);
  }
}

// One of the panes. `paint(context)` draws the picture in samples; `over(context, pane)` draws overlays in canvas px.
class Pane {
  constructor(id, view) {
    Object.assign(this, { canvas: byId(id), tip: byId(`${id}-tip`), view, pointers: new Map() });
    this.context = this.canvas.getContext('2d');
    view.panes.push(this);
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
  }

  resize() {
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * this.ratio));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * this.ratio));
    this.draw();
  }

  get scale() {
    return this.view.zoom * Math.min(this.canvas.width / grid.width, this.canvas.height / grid.height);
  }

  // The position of the first sample, canvas px: the picture is centred along a side that is visible as a whole.
  get left() {
    const whole = this.scale * grid.width;
    return whole <= this.canvas.width ? (this.canvas.width - whole) / 2 : Math.min(0, Math.max(this.canvas.width - whole, this.canvas.width / 2 - this.scale * this.view.x));
  }

  get top() {
    const whole = this.scale * grid.height;
    return whole <= this.canvas.height ? (this.canvas.height - whole) / 2 : Math.min(0, Math.max(this.canvas.height - whole, this.canvas.height / 2 - this.scale * this.view.y));
  }

  draw() {
    const { context, canvas, scale, left, top } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.setTransform(scale, 0, 0, scale, left, top);
    // At high magnification, pixels have sharp edges.
    context.imageSmoothingEnabled = scale < 3 * this.ratio;
    context.imageSmoothingQuality = 'high';
    this.paint?.(context);
    context.setTransform(1, 0, 0, 1, 0, 0);
    tool.draw(context, this);
    this.drawCursor();
    this.pin();
  }

  // The middle of the sample in canvas px.
  at([x, y]) {
    return [this.left + this.scale * (x + 0.5), this.top + this.scale * (y + 0.5)];
  }

  // The text over the picture stays inside it.
  pin() {
    const [x, y] = [this.left, this.top].map((px) => Math.max(0, px) / this.ratio);
    this.canvas.parentElement.style.setProperty('--left', `${x}px`);
    this.canvas.parentElement.style.setProperty('--below', `${y}px`);
    const { cursor } = this.view;
    this.tip.hidden = !cursor;
    if (!cursor) return;
    const i = cursor[1] * grid.width + cursor[0];
    const [px, py] = this.at(cursor).map((v) => v / this.ratio);
    this.tip.textContent = `${withDeviation(main.values[i], sureness.values[i], main)} ${Number.isNaN(main.values[i]) || !Number.isFinite(sureness.values[i]) ? '' : main.unit}`;
    const { clientWidth, clientHeight } = this.canvas;
    this.tip.style.left = `${Math.min(Math.max(px + 14, 4), clientWidth - this.tip.offsetWidth - 4)}px`;
    this.tip.style.top = `${py > clientHeight - 48 ? py - 40 : py + 14}px`;
    this.tip.hidden = px < 0 || py < 0 || px > clientWidth || py > clientHeight;
  }

  drawCursor() {
    const { context, ratio, scale, view: { cursor } } = this;
    if (!cursor) return;
    const [x, y] = this.at(cursor);
    const gap = Math.max(4 * ratio, scale * 0.75);
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

  // The position of an event in the canvas, and its sample.
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio];
    return { x, y, column: (x - this.left) / this.scale, row: (y - this.top) / this.scale };
  }

  read({ column, row }) {
    if (column >= 0 && row >= 0 && column < grid.width && row < grid.height) this.view.point(Math.floor(column), Math.floor(row));
  }

  listen() {
    const { canvas, view } = this;
    // One finger scrolls the page. Two fingers move and magnify the picture.
    canvas.style.touchAction = 'pan-y';
    let drag = null;
    canvas.addEventListener('pointerdown', (event) => {
      const place = this.place(event);
      this.pointers.set(event.pointerId, place);
      if (this.pointers.size === 2) return this.startPinch();
      drag = { ...place, viewX: view.x, viewY: view.y, grabbed: this.grab?.(place) || tool.start(place), far: false };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener('pointermove', (event) => {
      const place = this.place(event);
      if (this.pointers.has(event.pointerId)) this.pointers.set(event.pointerId, place);
      if (this.pinch) return this.movePinch();
      if (!drag && !view.held) this.read(place);
      if (!drag) return;
      drag.far ||= Math.hypot(place.x - drag.x, place.y - drag.y) > 4 * this.ratio;
      if (drag.grabbed) return drag.grabbed(place, false);
      if (!drag.far || view.fitted) return;
      [view.x, view.y] = [drag.viewX - (place.x - drag.x) / this.scale, drag.viewY - (place.y - drag.y) / this.scale];
      view.moved();
    });
    canvas.addEventListener('pointerup', (event) => {
      const place = this.place(event);
      this.pointers.delete(event.pointerId);
      if (this.pinch) return void (this.pinch = this.pointers.size ? this.pinch : null);
      if (drag?.grabbed) drag.grabbed(place, true);
      else if (drag && !drag.far) {
        view.held = event.pointerType !== 'mouse' || !view.held;
        this.read(place);
      }
      drag = null;
    });
    canvas.addEventListener('pointercancel', (event) => {
      this.pointers.delete(event.pointerId);
      drag = null;
      if (!this.pointers.size) this.pinch = null;
    });
    canvas.addEventListener('wheel', (event) => {
      // The wheel scrolls the page until the picture has the focus.
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      const { column, row } = this.place(event);
      view.zoomBy(Math.exp(-event.deltaY / 400), [column, row]);
    }, { passive: false });
    canvas.addEventListener('keydown', (event) => this.key(event));
  }

  startPinch() {
    const [a, b] = [...this.pointers.values()];
    this.pinch = { apart: Math.hypot(a.x - b.x, a.y - b.y), zoom: this.view.zoom, column: (a.column + b.column) / 2, row: (a.row + b.row) / 2 };
  }

  movePinch() {
    const [a, b] = [...this.pointers.values()];
    if (!b) return;
    const { view, pinch } = this;
    view.zoom = Math.min(200, Math.max(1, (pinch.zoom * Math.hypot(a.x - b.x, a.y - b.y)) / Math.max(1, pinch.apart)));
    view.x = pinch.column - ((a.x + b.x) / 2 - this.canvas.width / 2) / this.scale;
    view.y = pinch.row - ((a.y + b.y) / 2 - this.canvas.height / 2) / this.scale;
    view.moved();
  }

  key(event) {
    const { view } = this;
    const step = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const [x, y] = view.cursor ?? [Math.floor(grid.width / 2), Math.floor(grid.height / 2)];
    const move = moves[event.key];
    if (move) {
      view.held = true;
      view.point(x + move[0], y + move[1]);
    } else if (event.key === 'Enter') tool.enter(x, y);
    else if (event.key === 'Escape') tool.clear();
    else if (event.key === '+' || event.key === '=') view.zoomBy(1.5);
    else if (event.key === '-') view.zoomBy(1 / 1.5);
    else if (event.key === '0') view.fit();
    else return;
    event.preventDefault();
  }
}
