// The numbers of the report, each with its unit.

const missing = 'none';
const number = (value, digits) => (value === null ? missing : plain(value, digits));
const plus = (value, digits) => (value === null ? missing : signed(value, digits));
const percent = (fraction, digits = 1) => (fraction === null ? missing : `${(100 * fraction).toFixed(digits)} %`);
const time = (ms) => (ms >= 10000 ? `${(ms / 1000).toFixed(1)} s` : ms >= 100 ? `${ms.toFixed(0)} ms` : `${ms.toFixed(1)} ms`);

const unit = (value, text) => (value === null ? '' : text);
const range = ({ min, max }, digits, write = plus) => (min === null ? missing : `${write(min, digits)} … ${write(max, digits)}`);
const deviation = (key) => fields[key]?.median ?? null;

// The few main figures, in large type.
function showFigures() {
  const [low, high] = quantiles(main.values, [0.01, 0.99]);
  const [sigma] = quantiles(sureness.values, [0.5]);
  const digits = Math.min(main.digits, Math.max(0, 1 - Math.floor(Math.log10(Math.max((high ?? 1) - (low ?? 0), 1e-9) / 10))));
  const write = (value) => (main.low < 0 ? signed(value, digits) : plain(value, digits));
  const count = report.warnings.length;
  const cards = [
    [main.name, low === null ? missing : `${write(low)} … ${write(high)}`, low === null ? '' : `${main.unit}, 1st to 99th percentile`, ''],
    ['Median σ', sigma === null ? missing : `± ${significant(sigma, 2)}`, sigma === null ? '' : main.unit, ''],
    ['Measured', percent(measuredShare()), isPair ? `of the pixels; ${percent(report.valid_fraction)} are valid` : 'of the pixels', ''],
    ['Warnings', count || 'none', isPair ? (report.converged ? 'converged' : 'not converged') : `${report.frames.length} frames`, count || report.converged === false ? 'bad' : 'good'],
  ];
  byId('figures').append(...cards.map(([name, value, text, kind]) =>
    element('div', { class: kind }, element('dt', {}, name), element('dd', {}, `${value} `, element('small', {}, text)))));
}

// The variation of the gain over I2, if it is noticeable.
const percents = (low, high) => `${plus(100 * (low - 1), 1)} … ${plus(100 * (high - 1), 1)} %`;
const shades = ({ range }) => range.some((factor) => Math.abs(factor - 1) > 0.02);

function row(name, value, text = '') {
  return element('tr', {}, element('th', { scope: 'row' }, name), element('td', { class: 'number' }, `${value}${text && ` ${text}`}`));
}

const group = (name) => element('tr', { class: 'group' }, element('th', { colspan: 2, scope: 'rowgroup' }, name));

function heads(...names) {
  return element('tr', {}, ...names.map((name, i) => element('th', { class: i ? 'number' : '', scope: 'col' }, name)));
}

function line(name, ...numbers) {
  return element('tr', {}, element('th', { scope: 'row' }, name), ...numbers.map((text) => element('td', { class: 'number' }, text)));
}

function ranges(name, found, digits, text, write = plus) {
  return [group(name), ...[['Least', 'min'], ['Median', 'median'], ['Greatest', 'max']].map(([title, key]) =>
    row(title, write(found[key], digits), unit(found[key], text)))];
}

function depthRows() {
  const { depth } = report;
  if (!depth) return [];
  return [...ranges('Depth', depth, 3, 'mm', number), row('Median of σ', number(deviation('depth_deviation'), 3), 'mm'),
    row('Valid, but out of range', depth.out_of_range, 'px'), ...lensRows(depth.lens)];
}

// The size of a pixel on the surface, if it is stated.
function pixelRows() {
  const { pixel_size_um: um } = report;
  return um ? [group('Surface'), row('Size of a pixel', Number(um.toPrecision(6)), 'µm')] : [];
}

function lensRows(lens) {
  if (!lens) return [];
  return [group('Lens'), row('Focal length', lens.focal_length_mm, 'mm'), row('f-number', lens.f_number), row('Pixel pitch', lens.pixel_pitch_mm, 'mm'),
    row('Focused at', lens.focus_mm.map((at) => Number(at.toPrecision(6))).join(' and '), 'mm'), row('Blur constant κ', Number(lens.kappa.toPrecision(5))),
    row('Telecentric', lens.telecentric ? 'yes' : 'no')];
}

function pairRows() {
  const { transform: t, gain, offset, shading } = report.frames[1];
  return [
    row('Size, method', `${report.size.width} × ${report.size.height} px, ${report.method}`),
    group('Transform: I2(T x) lines up with I1(x)'),
    row('Translation to the right', plus(t.tx_px, 5), 'px'),
    row('Translation downwards', plus(t.ty_px, 5), 'px'),
    row('Rotation, positive from right to down', plus(t.rotation_deg, 6), '°'),
    row('Scale', number(t.scale, 7)),
    ...(report.transform_deviation ? [row('Known to, at a corner', report.transform_deviation.corner_px.toPrecision(2), 'px')] : []),
    group('Exposure: gain × I2 + offset is like I1'),
    row('Gain', number(gain, 6)),
    row('Offset, white being 1', plus(offset, 6)),
    row('Shading: how the gain varies', percents(...shading.range)),
    ...depthRows(),
    ...pixelRows(),
    ...ranges('Relative blur V, of the valid pixels', report.relative_blur, 4, 'px²'),
    row('Smoothness α, as asked or as found', Number(report.regularization.toPrecision(2))),
    row('Clipped pixels of I1 and I2', report.frames.map((frame) => percent(frame.clipped_fraction ?? 0, 2)).join(' and ')),
    row(`At the limit of |V|, ${report.max_relative_blur} px²`, percent(report.saturated_fraction, 2)),
    row('Still changing at the end', percent(report.unsettled_fraction, 2)),
    row('Mean confidence', report.mean_confidence === null ? missing : report.mean_confidence.toPrecision(4)),
    group('Pixels'),
    row('Size', `${report.size.width} × ${report.size.height}`, 'px'),
    row('Valid', percent(report.valid_fraction, 2)),
    row('Converged', report.converged ? 'yes' : 'no'),
  ];
}

function sweepRows() {
  return [
    ...depthRows(),
    ...pixelRows(),
    ...ranges('Focus', report.focus, 4, report.focus_unit, number),
    row('Median of σ', number(deviation('uncertainty'), 4), report.focus_unit),
    row('Blur grows by', number(report.blur_rate_px2, 4), 'px² per squared setting'),
    group('Pixels'),
    row('Size', `${report.size.width} × ${report.size.height}`, 'px'),
    row('Valid', percent(report.valid_fraction, 2)),
  ];
}

function showFrames() {
  byId('frames').append(heads('File', 'Setting', 'Right, px', 'Down, px', 'Rotation, °', 'Scale', 'Gain', 'Offset', 'Shading'), ...report.frames.map((frame, n) => {
    const { transform: t, gain, offset, shading } = frame;
    const where = [plus(t.tx_px, 3), plus(t.ty_px, 3), plus(t.rotation_deg, 4), number(t.scale, 5)];
    return line(data.pictures[n], Number(frame.position.toPrecision(6)), ...where, number(gain, 4), plus(offset, 4), percents(...shading.range));
  }));
}

// The requested steps and profiles.
function showMeasured() {
  const { measurements } = report;
  if (!measurements) return;
  byId('measured').hidden = false;
  const known = (found, digits, text) => (found ? `${plus(found.value, digits)} ± ${number(found.standard_error, digits)} ${text}` : missing);
  const place = ([x, y, w, h]) => `${w} × ${h} px at ${x}, ${y}`;
  const steps = measurements.steps.map((step) =>
    line(`Step from ${place(step.from)} to ${place(step.to)}`, known(step.depth_mm, 3, 'mm'), known(step.difference, 3, step.unit)));
  const profiles = measurements.profiles.map((profile) => line(`Profile: ${profile.csv}, ${profile.png}`, '', ''));
  byId('measurements').append(heads('What', 'Depth', isPair ? 'Relative blur' : 'Focus'), ...steps, ...profiles);
}

function showNumbers() {
  showFigures();
  byId('results').append(...(isPair ? pairRows() : sweepRows()));
  showSettings();
  showMeasured();
  if (!isPair) return showFrames();
  showTimes();
  showLevels();
}

const units = {
  max_relative_blur: 'px²', largest_step: 'px² an iteration', smoothness_eta: 'px² a pixel',
  data_eta: 'units of intensity', tx_px: 'px', ty_px: 'px', rotation_deg: '°', offset: 'of white',
};

const words = (key) => key.replace(/_(px|deg)$/, '').replaceAll('_', ' ');

function setting(key, value, prefix = '') {
  if (value !== null && typeof value === 'object' && !Array.isArray(value)) {
    return Object.entries(value).flatMap(([inner, v]) => setting(inner, v, `${words(key)}: `));
  }
  const text = value === null ? 'auto' : value === true ? 'yes' : value === false ? 'no' : Array.isArray(value) ? JSON.stringify(value) : String(value);
  return [row(prefix + words(key), text, typeof value === 'number' ? units[key] : '')];
}

// The decoding of stored values to intensities, and its reason.
function valuesInWords() {
  const { decode, by } = report.values;
  const word = { stated: 'as asked', files: 'as the files say', assumed: 'assumed, the files do not say', noise: 'linear by their noise' };
  return `${decode === 'srgb' ? 'sRGB curve undone' : 'as stored'}, ${word[by]}`;
}

function showSettings() {
  const { device } = report;
  byId('settings').append(
    ...Object.entries(report.settings).flatMap(([key, value]) => setting(key, value)),
    row('values', valuesInWords()),
    row(isPair ? 'image focused nearer' : 'focused nearest', isPair ? `I${report.nearer}` : `the ${report.nearer === 1 ? 'first' : 'last'} frame`),
    group('Device'),
    row('Name', device.name),
    row('Driver', device.driver),
    row('UUID', device.uuid),
    row('parfocal', data.version),
  );
}

function showTimes() {
  const { total, gpu, passes = {} } = report.timings_ms;
  byId('time').textContent = `${time(total)} in all, ${time(gpu)} of it on the device.`;
  const sorted = Object.entries(passes).sort((a, b) => b[1] - a[1]);
  const most = Math.max(...sorted.map(([, ms]) => ms), 1e-9);
  byId('passes').append(...sorted.map(([name, ms]) => {
    const bar = element('span');
    bar.style.width = `${(100 * ms) / most}%`;
    return element('tr', {}, element('th', { scope: 'row' }, name), element('td', { class: 'number' }, time(ms)),
      element('td', { class: 'number' }, percent(ms / gpu)), element('td', { class: 'bar-cell', 'aria-hidden': 'true' }, bar));
  }));
  if (!sorted.length) byId('time').textContent += ' Passes are timed by --timings.';
}

function showLevels() {
  const heads = [['Level', ''], ['Iterations', 'number'], ['Energy, first', 'number'], ['last', 'number']];
  const finite = (level) => level.energy.filter((e) => e !== null);
  byId('levels').append(
    element('tr', {}, ...heads.map(([name, kind]) => element('th', { class: kind, scope: 'col' }, name))),
    ...report.levels.map((level) => element('tr', {},
      element('th', { scope: 'row' }, `${level.width} × ${level.height} px`),
      element('td', { class: 'number' }, level.iterations),
      ...[finite(level)[0], finite(level).at(-1)].map((e) => element('td', { class: 'number' }, e === undefined ? missing : e.toPrecision(4))))),
  );
  const plot = byId('energy');
  new ResizeObserver(() => plot.replaceChildren(energyPlot(plot.clientWidth))).observe(plot);
}
