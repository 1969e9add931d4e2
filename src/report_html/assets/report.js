// Puts the page together. `window.page` is for tests: it is set when all is drawn.

function showHead() {
  [byId('name-1').textContent, byId('name-2').textContent] = data.names;
  document.title = `${data.names.join(' with ')} – parfocal report`;
  byId('verdict').textContent = report.converged ? 'Converged' : 'Not converged';
  byId('verdict').classList.toggle('no', !report.converged);
  byId('lead').textContent = `${report.size.width} × ${report.size.height} px · method ${report.method} · ${report.device.name}`;
  byId('warnings').hidden = !report.warnings.length;
  byId('warnings').firstElementChild.append(...report.warnings.map((text) => element('li', {}, text)));
  byId('json').textContent = JSON.stringify(report, null, 2);
  const every = grid.step === 1 ? 'every pixel' : `every ${grid.step}th pixel of every ${grid.step}th row: the images are large`;
  byId('about').textContent = `Written by parfocal ${report.version}. It is one file and loads nothing. V and confidence are those of `
    + `relative_blur.exr and confidence.exr, bit by bit, at ${every}; the pictures are JPEG, made to look at and not to measure.`;
}

function showTheme() {
  byId('theme').addEventListener('click', () => {
    const style = document.documentElement.style;
    const dark = style.colorScheme ? style.colorScheme === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
    style.colorScheme = dark ? 'light' : 'dark';
  });
}

function showSurface(heights, viewer) {
  const span = `${signed(fields.relative_blur.low, 2)} to ${signed(fields.relative_blur.high, 2)} px²`;
  byId('surface-note').textContent = `Height is V, ${span} from ${fields.relative_blur.ends.join(' to ')}; it orders what is near and far and is `
    + 'not metric. Spikes are smoothed away; where V is not valid there is a hole.';
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
  showFigures();
  showResults();
  showSettings();
  showTimes();
  showLevels();
  const [relativeBlur, confidence, heights, i1, i2, fused] = await Promise.all([
    ...['relative-blur', 'confidence', 'heights'].map(floats), ...['i1', 'i2', 'fused'].map(picture)]);
  const viewer = new Viewer({ i1, i2, fused }, { relative_blur: relativeBlur, confidence });
  byId('loading').hidden = true;
  const surface = showSurface(heights, viewer);
  window.page = { viewer, surface, pixelOf };
}

start().catch((error) => {
  byId('loading').hidden = false;
  byId('loading').textContent = `This page could not be drawn: ${error.message}`;
  throw error;
});
