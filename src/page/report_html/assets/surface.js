// The surface in three dimensions.

class SurfaceView {
  // `skin(name)` returns the picture of each skin.
  constructor(heights, skin, colormap = () => data.colormap) {
    this.colormap = colormap;
    this.canvas = byId('surface');
    this.axes = byId('axes');
    this.field = fields[data.surface.field];
    byId('skins').append(element('button', { type: 'button', 'data-skin': this.field.key }, this.field.name));
    byId('relief').max = Math.max(60, Math.ceil(150 * data.surface.relief));
    this.skin = skin;
    this.textures = {};
    // The buffer is kept after drawing, so that the picture can be saved or printed at any time.
    this.renderer = new Three.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.scene = new Three.Scene();
    this.camera = new Three.PerspectiveCamera(30, 1, 0.05, 20);
    this.camera.up.set(0, 0, 1);
    this.light();
    this.material = new Three.MeshLambertMaterial({ side: Three.DoubleSide });
    this.mesh = new Three.Mesh(geometry(heights), this.material);
    this.scene.add(this.mesh);
    this.controls = new Three.OrbitControls(this.camera, this.canvas);
    this.controls.minDistance = 0.2;
    this.controls.maxDistance = 8;
    this.controls.maxPolarAngle = 0.49 * Math.PI;
    this.controls.addEventListener('change', () => this.draw());
    // One finger scrolls the page vertically, and rotates the surface horizontally.
    this.canvas.style.touchAction = 'pan-y';
    this.listen();
    this.setRelief(100 * data.surface.relief);
    this.setSkin('fused');
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
    this.reset();
  }

  light() {
    this.scene.add(new Three.AmbientLight(0xffffff, 1.5));
    const sun = new Three.DirectionalLight(0xffffff, 2);
    sun.position.set(-1, 1, 1.5);
    this.scene.add(sun);
  }

  listen() {
    // The wheel scrolls the page until the surface has the focus.
    this.controls.enableZoom = false;
    this.controls.addEventListener('start', () => { this.untouched = false; });
    this.canvas.addEventListener('pointerdown', () => this.canvas.focus({ preventScroll: true }));
    this.canvas.addEventListener('focus', () => { this.controls.enableZoom = true; });
    this.canvas.addEventListener('blur', () => { this.controls.enableZoom = false; });
    this.canvas.addEventListener('keydown', (event) => this.key(event));
    byId('skins').addEventListener('click', (event) => event.target.dataset.skin && this.setSkin(event.target.dataset.skin));
    byId('relief').addEventListener('input', (event) => this.setRelief(Number(event.target.value)));
    byId('reset').addEventListener('click', () => this.reset());
    byId('from-above').addEventListener('click', () => this.look(90, 0, this.distance(90, 0)));
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
    this.renderer.setSize(clientWidth, clientHeight, false);
    [this.axes.width, this.axes.height] = [this.canvas.width, this.canvas.height];
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    if (this.untouched) this.reset();
    this.draw();
  }

  // The least distance at which all corners are visible from a direction, with room for the key on the left.
  distance(elevation = data.surface.elevation_deg, azimuth = data.surface.azimuth_deg) {
    const { width, height } = data.surface;
    const [x, y] = [width, height].map((side) => side / 2 / Math.max(width, height));
    const z = Math.max(this.mesh.scale.z, 1e-3) / 2;
    const [e, a] = [elevation, azimuth].map((degrees) => (degrees * Math.PI) / 180);
    const towards = new Three.Vector3(Math.cos(e) * Math.sin(a), -Math.cos(e) * Math.cos(a), Math.sin(e));
    const right = new Three.Vector3(Math.cos(a), Math.sin(a), 0);
    const up = new Three.Vector3().crossVectors(towards, right);
    const half = Math.tan((this.camera.fov / 2) * (Math.PI / 180));
    let far = 0.3;
    for (const sx of [-x, x]) for (const sy of [-y, y]) for (const sz of [-z, z]) {
      const corner = new Three.Vector3(sx, sy, sz);
      const [across, upwards, near] = [Math.abs(corner.dot(right)), Math.abs(corner.dot(up)), corner.dot(towards)];
      far = Math.max(far, near + across / (half * this.camera.aspect * 0.93), near + upwards / (half * 0.97));
    }
    return far;
  }

  // The position of the camera and its target.
  direction() {
    return [...this.camera.position.toArray(), ...this.controls.target.toArray()];
  }

  setDirection([x, y, z, ...target]) {
    this.camera.position.set(x, y, z);
    this.controls.target.set(...target);
    this.controls.update();
    this.draw();
  }

  look(elevation, azimuth, distance) {
    const [e, a] = [Math.min(89.99, elevation), azimuth].map((degrees) => (degrees * Math.PI) / 180);
    this.controls.target.set(0, 0, 0);
    this.camera.position.set(Math.cos(e) * Math.sin(a), -Math.cos(e) * Math.cos(a), Math.sin(e)).multiplyScalar(distance);
    this.controls.update();
    this.draw();
  }

  reset() {
    this.untouched = true;
    this.setRelief(100 * data.surface.relief);
    this.look(data.surface.elevation_deg, data.surface.azimuth_deg, this.distance());
  }

  // Rotates by degrees about the target, and changes the distance by a factor.
  turn(around, up, factor = 1) {
    this.untouched = false;
    const { camera, controls } = this;
    const offset = camera.position.clone().sub(controls.target).multiplyScalar(factor);
    const distance = Math.min(8, Math.max(0.2, offset.length()));
    const azimuth = Math.atan2(offset.x, -offset.y) + (around * Math.PI) / 180;
    const elevation = Math.min(1.57, Math.max(0.04, Math.asin(offset.z / offset.length()) + (up * Math.PI) / 180));
    const flat = Math.cos(elevation);
    camera.position.set(flat * Math.sin(azimuth), -flat * Math.cos(azimuth), Math.sin(elevation)).multiplyScalar(distance);
    camera.position.add(controls.target);
    controls.update();
    this.draw();
  }

  key(event) {
    const turns = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5], '+': [0, 0, 0.85], '=': [0, 0, 0.85], '-': [0, 0, 1.18] };
    if (turns[event.key]) this.turn(...turns[event.key]);
    else if (event.key === '0') this.reset();
    else return;
    event.preventDefault();
  }

  setRelief(percent) {
    byId('relief').value = percent;
    const true_ = data.surface.to_scale && Math.abs(percent - 100 * data.surface.relief) < 0.51;
    byId('relief-value').value = `${Math.round(percent)} %${true_ ? ', to scale' : ''}`;
    // A flat surface is drawn with a small height, since normals need one.
    this.mesh.scale.z = Math.max(percent / 100, 1e-4);
    this.draw();
  }

  setSkin(name) {
    this.skinName = name;
    for (const button of byId('skins').children) button.setAttribute('aria-pressed', button.dataset.skin === name);
    this.textures[name] ??= this.texture(this.skin(name));
    this.material.map = this.textures[name];
    this.material.needsUpdate = true;
    this.draw();
  }

  // At most 2048 texels per side, which every device supports.
  texture(source) {
    const factor = Math.min(1, 2048 / Math.max(grid.width, grid.height));
    const canvas = canvasOf(Math.round(factor * grid.width), Math.round(factor * grid.height));
    canvas.getContext('2d').drawImage(source, 0, 0, canvas.width, canvas.height);
    const texture = new Three.CanvasTexture(canvas);
    texture.colorSpace = Three.SRGBColorSpace;
    texture.anisotropy = this.renderer.capabilities.getMaxAnisotropy();
    return texture;
  }

  draw() {
    this.renderer.render(this.scene, this.camera);
    this.drawAxes();
  }

  // The position in the picture of a point of the surface's box, px.
  project(x, y, z) {
    const seen = new Three.Vector3(x, y, z).project(this.camera);
    return [((seen.x + 1) / 2) * this.axes.width, ((1 - seen.y) / 2) * this.axes.height];
  }

  // The heights with their unit, at the leftmost corner, where the surface hides nothing; and the sides.
  drawAxes() {
    const { width, height } = data.surface;
    const [x, y] = [width, height].map((side) => side / 2 / Math.max(width, height));
    const relief = this.mesh.scale.z;
    const context = this.axes.getContext('2d');
    const ratio = this.renderer.getPixelRatio();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.axes.width, this.axes.height);
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.fillStyle = context.strokeStyle = getComputedStyle(this.axes).color;
    context.lineWidth = ratio;
    const corners = [[-x, -y], [x, -y], [x, y], [-x, y]];
    const seen = corners.map(([cx, cy]) => this.project(cx, cy, -relief / 2));
    const leftmost = seen.reduce((best, place, i) => (place[0] < seen[best][0] ? i : best), 0);
    const at = (z) => this.project(...corners[leftmost], z * relief);
    const [foot, head] = [at(-0.5), at(0.5)];
    const long = Math.hypot(head[0] - foot[0], head[1] - foot[1]);
    context.textBaseline = 'middle';
    if (long > 40 * ratio) {
      context.textAlign = 'right';
      const line = (from, to) => { context.beginPath(); context.moveTo(...from); context.lineTo(...to); context.stroke(); };
      line(foot, head);
      for (const { value, text } of this.field.ticks(Math.min(8, long / (18 * ratio)))) {
        const [tx, ty] = at(this.field.position(value) - 0.5);
        line([tx - 5 * ratio, ty], [tx, ty]);
        context.fillText(text, tx - 8 * ratio, ty);
      }
      // Stays within the picture, however far to the left the corner is.
      const title = Math.max(head[0] - 8 * ratio, context.measureText(this.field.title).width + 6 * ratio);
      context.fillText(this.field.title, title, Math.max(10 * ratio, head[1] - 18 * ratio));
    }
    this.drawKey(context, ratio);
    // The two sides of the base that are nearest to the camera.
    context.textAlign = 'center';
    const middle = this.project(0, 0, -relief / 2);
    corners.forEach(([cx, cy], i) => {
      const [nx, ny] = corners[(i + 1) % 4];
      const place = this.project((cx + nx) / 2, (cy + ny) / 2, -relief / 2);
      if (place[1] <= middle[1] + 10 * ratio) return;
      const out = Math.hypot(place[0] - middle[0], place[1] - middle[1]);
      const [dx, dy] = [0, 1].map((k) => ((place[k] - middle[k]) / out) * 32 * ratio);
      context.fillText(`${i % 2 ? report.size.height : report.size.width} px`, place[0] + dx, place[1] + dy);
    });
  }

  // The colour key of the heights, inside the picture, if they determine its colours.
  drawKey(context, ratio) {
    if (this.skinName !== this.field.key) return;
    const [width, height, left] = [12 * ratio, this.axes.height * 0.5, this.axes.width - 26 * ratio];
    const top = (this.axes.height - height) / 2;
    const colors = colorsOf(data.colormaps[this.colormap()]);
    for (let i = 0; i < height; i++) {
      const [r, g, b] = colors[Math.round(255 * (1 - i / height))];
      context.fillStyle = `rgb(${r} ${g} ${b})`;
      context.fillRect(left, top + i, width, 1);
    }
    context.fillStyle = getComputedStyle(this.axes).color;
    context.textAlign = 'right';
    for (const { value, text } of this.field.ticks(4)) context.fillText(text, left - 5 * ratio, top + height * (1 - this.field.position(value)));
  }
}

// Two triangles between each four neighbouring nodes, one between three valid nodes; holes stay open. x is right, y up,
// z near, and the longer side is 1. z is from -1/2 to 1/2 and is scaled by the relief.
function geometry(heights) {
  const { width, height } = data.surface;
  const longer = Math.max(width, height);
  const index = new Int32Array(width * height).fill(-1);
  const [positions, uvs, triangles] = [[], [], []];
  heights.forEach((nearness, at) => {
    if (Number.isNaN(nearness)) return;
    index[at] = positions.length / 3;
    const [u, v] = [((at % width) + 0.5) / width, (Math.floor(at / width) + 0.5) / height];
    positions.push(((u - 0.5) * width) / longer, ((0.5 - v) * height) / longer, nearness - 0.5);
    uvs.push(u, 1 - v);
  });
  for (let y = 1; y < height; y++) {
    for (let x = 1; x < width; x++) {
      const at = y * width + x;
      const [a, b, c, d] = [at - width - 1, at - width, at, at - 1].map((i) => index[i]);
      // Counter-clockwise as seen from the camera.
      const cuts = a < 0 || c < 0 ? [[b, d, c], [a, d, b]] : [[a, c, b], [a, d, c]];
      for (const cut of cuts) if (!cut.includes(-1)) triangles.push(...cut);
    }
  }
  const found = new Three.BufferGeometry();
  found.setAttribute('position', new Three.BufferAttribute(new Float32Array(positions), 3));
  found.setAttribute('uv', new Three.BufferAttribute(new Float32Array(uvs), 2));
  found.setIndex(new Three.BufferAttribute(new Uint32Array(triangles), 1));
  found.computeVertexNormals();
  return found;
}
