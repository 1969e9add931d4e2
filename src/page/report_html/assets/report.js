// Puts the page together. `window.page` is for tests: it is set when all is drawn.

function showHead() {
  const between = isPair ? 'with' : 'to';
  [byId('name-1').textContent, byId('name-2').textContent] = data.names;
  byId('between').textContent = between;
  document.title = `${data.names.join(` ${between} `)} – parfocal report`;
  byId('verdict').hidden = !isPair;
  byId('verdict').textContent = report.converged ? 'Converged' : 'Not converged';
  byId('verdict').classList.toggle('no', !report.converged);
  const how = isPair ? `method ${report.method}` : `focus sweep of ${report.frames.length} frames`;
  byId('lead').textContent = `${report.size.width} × ${report.size.height} px · ${how} · ${report.device.name}`;
  byId('warnings').hidden = !report.warnings.length;
  byId('warnings').firstElementChild.append(...report.warnings.map((text) => element('li', {}, text)));
  byId('json').textContent = JSON.stringify(report, null, 2);
  const every = grid.step === 1 ? 'every pixel' : `every ${grid.step}th pixel of every ${grid.step}th row: the images are large`;
  byId('about').textContent = `Written by parfocal ${data.version}. It is one file and loads nothing. It holds the values of the EXR files `
    + `to the digits shown, at ${every}; the pictures are JPEG, made to look at and not to measure.`;
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

function showSurface(heights, viewer) {
  const field = fields[data.surface.field];
  const order = field.reversed ? [field.high, field.low] : [field.low, field.high];
  const span = order.map((value) => plain(value, Math.min(2, field.digits))).join(' to ');
  const metric = field.unit === 'mm' ? '' : '; it orders what is near and far and is not metric';
  byId('surface-note').textContent = `Height is ${field.sign}, ${span} ${field.unit} from far to near${metric}. Stretched by the relief; `
    + 'spikes are smoothed away, and where there is no value there is a hole.';
  try {
    return new SurfaceView(heights, (name) => viewer.layer(name));
  } catch (error) {
    byId('no-surface').hidden = false;
    byId('no-surface').textContent = `This browser cannot draw it: ${error.message}`;
    return null;
  }
}

async function start() {
  showHead();
  showTheme();
  showNumbers();
  const { width, digits } = data.surface;
  const [heights, pictures] = await Promise.all([decimals('heights', width, digits),
    Promise.all(data.pictures.map((_, i) => picture(`picture-${i}`))), ...Object.values(fields).map((field) => field.unpack())]);
  const viewer = new Viewer(pictures);
  byId('loading').hidden = true;
  const surface = showSurface(heights, viewer);
  window.page = { viewer, surface, pixelOf, fields };
}

start().catch((error) => {
  byId('loading').hidden = false;
  byId('loading').textContent = `This page could not be drawn: ${error.message}`;
  throw error;
});
