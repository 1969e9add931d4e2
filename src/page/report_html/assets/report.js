// Assembles the page. `window.page` is for tests. It is set after everything is drawn.

let view = null;

const nearIs = () => {
  const near = isPair ? `I${report.nearer}` : `the ${report.nearer === 1 ? 'first' : 'last'} frame`;
  const by = {
    lens: 'by the lens', distances: 'by the distances', stated: 'as stated', scale: 'by the scale of the frames',
    exif: 'by the camera', assumed: 'assumed',
  }[report.nearer_by];
  if (!isPair && report.nearer_by === 'assumed') return 'nothing shows which end is near';
  return `near is ${near} (${by})`;
};

// The main result in one sentence.
function sentence() {
  const [low, high] = quantiles(main.values, [0.01, 0.99]);
  if (low === null) return 'Nothing is measured: see the warnings.';
  const [sigma] = quantiles(sureness.values, [0.5]);
  const digits = Math.min(main.digits, Math.max(0, 1 - Math.floor(Math.log10(Math.max(high - low, 1e-9) / 10))));
  const write = (value) => (main.low < 0 ? signed(value, digits) : plain(value, digits));
  // Parts that belong together stay on one line.
  const what = `${main.name} ${write(low)} to ${write(high)}\u00a0${main.unit}, typically ±\u00a0${significant(sigma, 2)}\u00a0${main.unit}`;
  const share = 100 * measuredShare();
  return `${what}; ${share > 99 && share < 100 ? 'over 99' : plain(share, 0)}\u00a0% measured; ${nearIs()}.`;
}

function showHead() {
  const between = isPair ? 'with' : 'to';
  [byId('name-1').textContent, byId('name-2').textContent] = data.names;
  byId('between').textContent = between;
  document.title = `${data.names.join(` ${between} `)} – parfocal report`;
  byId('warnings').hidden = !report.warnings.length;
  byId('warnings').querySelector('ul').append(...report.warnings.map((text) => element('li', {}, text)));
  byId('json').textContent = JSON.stringify(report, null, 2);
  const every = grid.step === 1 ? 'every pixel' : `every ${grid.step}th pixel of every ${grid.step}th row: the images are large`;
  byId('about').textContent = `Written by parfocal ${data.version}. It is one file and loads nothing. It holds the values of the EXR files, `
    + `rounded to a fifth of their typical σ or finer and deviations to a hundredth of themselves, at ${every}; the pictures are JPEG, made to look at and not to measure.`;
  for (const part of document.querySelectorAll('[data-kind]')) part.hidden = part.dataset.kind !== data.kind;
}

function showTheme() {
  byId('theme').addEventListener('click', () => {
    const style = document.documentElement.style;
    const dark = style.colorScheme ? style.colorScheme === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
    style.colorScheme = dark ? 'light' : 'dark';
    window.page?.surface?.draw();
  });
}

function showSurface(heights, map) {
  const field = fields[data.surface.field];
  const order = field.reversed ? [field.high, field.low] : [field.low, field.high];
  const span = order.map((value) => plain(value, Math.min(2, field.digits))).join(' to ');
  const metric = field.unit === 'mm' ? (data.surface.to_scale ? ', true to scale at first' : '') : '; it orders what is near and far and is not metric';
  byId('surface-note').textContent = `Height is ${field.sign}, ${span} ${field.unit} from far to near${metric}. `
    + 'Spikes are smoothed away, and where there is no value there is a hole.';
  try {
    return new SurfaceView(heights, (name) => (name === 'fused' ? map.pictures.at(-1) : map.layer(name)));
  } catch (error) {
    byId('no-surface').hidden = false;
    byId('no-surface').textContent = `This browser cannot draw it: ${error.message}`;
    return null;
  }
}

// Shows one pane alone, or all three.
function enlarge(name) {
  const hero = byId('hero');
  const next = name && hero.dataset.large !== name ? name : '';
  hero.dataset.large = next;
  for (const button of hero.querySelectorAll('[data-enlarge]')) button.setAttribute('aria-pressed', button.dataset.enlarge === next);
}

// Converts the state of the view to the fragment of a link, and back.
function fragment({ viewer, map, surface }) {
  const state = { photo: viewer.mode, map: map.mode, colors: map.colormaps[map.mode], split: viewer.split.toFixed(3), sigma: byId('sigma').value };
  if (view.cursor) state.at = view.cursor.join(',');
  if (!view.fitted) state.zoom = [view.zoom, view.x, view.y].map((v) => Number(v.toFixed(3))).join(',');
  if (tool.line) state.line = tool.line.join(',');
  if (tool.rectangles.length) state.step = tool.rectangles.flat().join(',');
  if (byId('hero').dataset.large) state.large = byId('hero').dataset.large;
  if (surface) Object.assign(state, { relief: byId('relief').value, turn: surface.direction().map((v) => v.toFixed(3)).join(',') });
  return new URLSearchParams(state).toString();
}

function restore({ viewer, map, surface }) {
  const state = new URLSearchParams(location.hash.slice(1));
  const numbers = (key, count) => {
    const found = (state.get(key) ?? '').split(',').map(Number);
    return found.length >= count && found.every(Number.isFinite) && state.has(key) ? found : null;
  };
  const clamp = ([x, y]) => [Math.round(x), Math.round(y)].map((v, k) => Math.min([grid.width, grid.height][k] - 1, Math.max(0, v)));
  if (['fused', 'compare', 'difference', ...(data.frames ? ['frames'] : [])].includes(state.get('photo'))) viewer.show(state.get('photo'));
  const colors = numbers('colors', 1)?.[0];
  const mode = fields[state.get('map')] ? state.get('map') : map.mode;
  if (data.colormaps[colors]) map.colormaps[mode] = colors;
  map.show(mode);
  if (numbers('split', 1)) viewer.setSplit(numbers('split', 1)[0]);
  if (numbers('sigma', 1)) map.setThreshold(Math.min(1000, Math.max(0, numbers('sigma', 1)[0])));
  if (['photo', 'map', 'surface'].includes(state.get('large'))) enlarge(state.get('large'));
  const line = numbers('line', 4);
  if (line) tool.line = [...clamp(line.slice(0, 2)), ...clamp(line.slice(2, 4))];
  const rectangles = numbers('step', 4);
  if (rectangles) {
    tool.rectangles = Array.from({ length: Math.min(2, Math.floor(rectangles.length / 4)) }, (_, i) => {
      const [x, y] = clamp(rectangles.slice(4 * i));
      const [w, h] = rectangles.slice(4 * i + 2, 4 * i + 4).map((v) => Math.max(1, Math.round(v)));
      return [x, y, Math.min(w, grid.width - x), Math.min(h, grid.height - y)];
    });
  }
  const zoom = numbers('zoom', 3);
  if (zoom) Object.assign(view, { zoom: Math.min(200, Math.max(1, zoom[0])), x: zoom[1], y: zoom[2] });
  view.moved();
  const at = numbers('at', 2);
  if (at) {
    view.held = true;
    view.point(...clamp(at));
  }
  tool.show();
  if (numbers('relief', 1)) surface?.setRelief(numbers('relief', 1)[0]);
  if (numbers('turn', 6)) surface?.setDirection(numbers('turn', 6));
}

async function copy(button, text) {
  const said = button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = 'Copied';
  } catch {
    // A browser may refuse this for a local file. The user can copy the text by hand.
    prompt('Copy:', text);
  }
  setTimeout(() => { button.textContent = said; }, 1500);
}

function showTools(page) {
  byId('tools').addEventListener('click', (event) => event.target.dataset.tool && tool.choose(event.target.dataset.tool));
  byId('clear').addEventListener('click', () => tool.clear());
  byId('copy-command').addEventListener('click', (event) => copy(event.target, byId('command').textContent));
  byId('copy-link').addEventListener('click', (event) => {
    history.replaceState(null, '', `#${fragment(page)}`);
    copy(event.target, location.href);
  });
  byId('save').addEventListener('click', () => page.map.png().toBlob((blob) => {
    const link = element('a', { download: `${page.map.mode}.png`, href: URL.createObjectURL(blob) });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }));
  byId('zoom-in').addEventListener('click', () => view.zoomBy(1.5));
  byId('zoom-out').addEventListener('click', () => view.zoomBy(1 / 1.5));
  byId('fit').addEventListener('click', () => view.fit());
  byId('hero').addEventListener('click', (event) => event.target.dataset.enlarge && enlarge(event.target.dataset.enlarge));
  new ResizeObserver(() => tool.line && tool.show()).observe(byId('measure-panel'));
}

async function start() {
  showHead();
  showTheme();
  const { width, digits } = data.surface;
  const [heights, pictures] = await Promise.all([decimals('heights', width, digits),
    Promise.all(data.pictures.map((_, i) => picture(`picture-${i}`))), filled?.unpack(), ...Object.values(fields).map((field) => field.unpack())]);
  for (const field of Object.values(fields)) field.compute();
  document.documentElement.style.setProperty('--ratio', `${grid.width} / ${grid.height}`);
  showNumbers();
  view = new View();
  const map = new MapPane(view);
  const viewer = new PhotoPane(pictures, view);
  map.pictures = pictures;
  view.moved();
  byId('sentence').textContent = sentence();
  byId('loading').hidden = true;
  if (data.frames) {
    const curve = new FocusCurve(pictures);
    view.watchers.push((at) => curve.show(at));
    curve.show(Math.floor(grid.height / 2) * grid.width + Math.floor(grid.width / 2));
  }
  const surface = showSurface(heights, map);
  const page = { viewer, map, view, surface, pixelOf, fields, tool };
  showTools(page);
  restore(page);
  window.page = page;
}

start().catch((error) => {
  byId('loading').hidden = false;
  byId('loading').textContent = `This page could not be drawn: ${error.message}`;
  throw error;
});
