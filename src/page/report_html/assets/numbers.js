// The numbers of the report, each with its unit.

function element(name, attributes = {}, ...children) {
  const found = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  found.append(...children);
  return found;
}

const missing = 'none';
const number = (value, digits) => (value === null ? missing : (value < 0 ? '−' : '') + Math.abs(value).toFixed(digits));
const plus = (value, digits) => (value === null ? missing : signed(value, digits));
const percent = (fraction, digits = 1) => (fraction === null ? missing : `${(100 * fraction).toFixed(digits)} %`);
const time = (ms) => (ms >= 10000 ? `${(ms / 1000).toFixed(1)} s` : ms >= 100 ? `${ms.toFixed(0)} ms` : `${ms.toFixed(1)} ms`);

const unit = (value, text) => (value === null ? '' : text);
const range = ({ min, max }, digits, write = plus) => (min === null ? missing : `${write(min, digits)} … ${write(max, digits)}`);
const deviation = (key) => fields[key]?.median ?? null;

// Few figures, large: what a person looks at first.
function showFigures() {
  byId('figures').append(...(isPair ? pairFigures() : sweepFigures()).map(([name, value, text]) =>
    element('div', {}, element('dt', {}, name), element('dd', {}, `${value} `, element('small', {}, text)))));
}

function depthFigures(depth) {
  return [['Depth', number(depth.median, 2), unit(depth.median, 'mm median')], ['Range of depth', range(depth, 1, number), unit(depth.min, 'mm')]];
}

function pairFigures() {
  const { transform: t, photometric: p, shading, relative_blur: v, depth } = report;
  const blur = [['Relative blur', plus(v.median, 2), unit(v.median, 'px² median')], ['Range of V', range(v, 1), unit(v.min, 'px²')]];
  return [
    ['I2 lies', `${plus(t.tx_px, 3)}, ${plus(t.ty_px, 3)}`, 'px right, down'],
    ['Rotation', `${plus(t.rotation_deg, 4)}°`, ''],
    ['Scale', number(t.scale, 5), `${plus(100 * (t.scale - 1), 3)} %`],
    ['Gain', number(p.gain, 4), `offset ${plus(p.offset, 4)}${shades(shading) ? `, shading ${percents(...shading.range)}` : ''}`],
    ...(depth ? depthFigures(depth) : blur),
    ['Valid', percent(report.valid_fraction), 'of the pixels'],
    ['Time', time(report.timings_ms.total), `${time(report.timings_ms.gpu)} on the device`],
  ];
}

function sweepFigures() {
  const { focus, depth, frames } = report;
  const text = report.focus_unit ?? 'settings';
  return [
    ['Frames', frames.length, `reference ${report.reference + 1}`],
    ['Settings', `${frames[0].position} … ${frames.at(-1).position}`, text],
    ['Focus', number(focus.median, 2), unit(focus.median, `${text}, median`)],
    ['Range of focus', range(focus, 2, number), unit(focus.min, text)],
    ...(depth ? depthFigures(depth) : [['Blur grows by', number(report.blur_rate_px2, 3), 'px² a squared setting'],
      ['σ of focus', number(deviation('uncertainty'), 3), `${text}, median`]]),
    ['Valid', percent(report.valid_fraction), 'of the pixels'],
    ['Time', time(report.total_ms), ''],
  ];
}

// How the gain varies over I2, where it is worth a word.
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

function lensRows(lens) {
  if (!lens) return [];
  return [group('Lens'), row('Focal length', lens.focal_length_mm, 'mm'), row('f-number', lens.f_number), row('Pixel pitch', lens.pixel_pitch_mm, 'mm'),
    row('Focused at', lens.focus_mm.map((at) => Number(at.toPrecision(6))).join(' and '), 'mm'), row('Blur constant κ', Number(lens.kappa.toPrecision(5))),
    row('Telecentric', lens.telecentric ? 'yes' : 'no')];
}

function pairRows() {
  const { transform: t, photometric: p, shading } = report;
  return [
    group('Transform: I2(T x) lines up with I1(x)'),
    row('Translation to the right', plus(t.tx_px, 5), 'px'),
    row('Translation downwards', plus(t.ty_px, 5), 'px'),
    row('Rotation, positive from right to down', plus(t.rotation_deg, 6), '°'),
    row('Scale', number(t.scale, 7)),
    group('Exposure: gain × I2 + offset is like I1'),
    row('Gain', number(p.gain, 6)),
    row('Offset, white being 1', plus(p.offset, 6)),
    row('Shading: how the gain varies', percents(...shading.range)),
    ...depthRows(),
    ...ranges('Relative blur V, of the valid pixels', report.relative_blur, 4, 'px²'),
    row('Smoothness α, as asked or as found', Number(report.regularization.toPrecision(2))),
    row('At the limit of |V|', percent(report.saturated_fraction, 2)),
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
    ...ranges('Focus', report.focus, 4, report.focus_unit ?? 'settings', number),
    row('Median of σ', number(deviation('uncertainty'), 4), report.focus_unit ?? 'settings'),
    row('Blur grows by', number(report.blur_rate_px2, 4), 'px² a squared setting'),
    group('Pixels'),
    row('Size', `${report.size.width} × ${report.size.height}`, 'px'),
    row('Valid', percent(report.valid_fraction, 2)),
  ];
}

function showFrames() {
  byId('frames').append(heads('File', 'Setting', 'Right, px', 'Down, px', 'Rotation, °', 'Scale', 'Gain', 'Offset', 'Shading'), ...report.frames.map((frame, n) => {
    const { transform: t, photometric: p, shading } = frame;
    const where = [plus(t.tx_px, 3), plus(t.ty_px, 3), plus(t.rotation_deg, 4), number(t.scale, 5)];
    return line(data.pictures[n], Number(frame.position.toPrecision(6)), ...where, number(p.gain, 4), plus(p.offset, 4), percents(...shading.range));
  }));
}

// Steps and lines that were asked for.
function showMeasured() {
  const { measurements } = report;
  if (!measurements) return;
  byId('measured').hidden = false;
  const known = (found, digits, text) => (found ? `${plus(found.value, digits)} ± ${number(found.standard_error, digits)} ${text}` : missing);
  const place = ([x, y, w, h]) => `${w} × ${h} px at ${x}, ${y}`;
  const steps = measurements.steps.map((step) =>
    line(`Step from ${place(step.from)} to ${place(step.to)}`, known(step.depth_mm, 3, 'mm'), isPair ? known(step.relative_blur, 3, 'px²') : known(step.focus, 3, report.focus_unit)));
  const profiles = measurements.profiles.map((profile) => line(`Profile: ${profile.csv}, ${profile.png}`, '', ''));
  byId('measurements').append(heads('', 'Depth', isPair ? 'Relative blur' : 'Focus'), ...steps, ...profiles);
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
  max_relative_blur: 'px²', largest_step: 'px² an iteration', smoothness_eta: 'px² a pixel', heaviside_epsilon: 'px²',
  data_eta: 'of white', tx_px: 'px', ty_px: 'px', rotation_deg: '°', offset: 'of white',
};

const words = (key) => key.replace(/_(px|deg)$/, '').replaceAll('_', ' ');

function setting(key, value, prefix = '') {
  if (value !== null && typeof value === 'object' && !Array.isArray(value)) {
    return Object.entries(value).flatMap(([inner, v]) => setting(inner, v, `${words(key)}: `));
  }
  const text = value === null ? 'auto' : value === true ? 'yes' : value === false ? 'no' : Array.isArray(value) ? JSON.stringify(value) : String(value);
  return [row(prefix + words(key), text, typeof value === 'number' ? units[key] : '')];
}

// How stored values became intensities, and on whose word.
function valuesInWords() {
  const { decode, by } = report.values;
  const word = { stated: 'as asked', files: 'as the files say', assumed: 'assumed, the files do not say' };
  return `${decode === 'srgb' ? 'sRGB curve undone' : 'as stored'}, ${word[by]}`;
}

function showSettings() {
  const { device } = report;
  byId('settings').append(
    ...Object.entries(report.settings ?? {}).flatMap(([key, value]) => setting(key, value)),
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
  const { total, gpu, passes } = report.timings_ms;
  byId('time').textContent = `${time(total)} in all, ${time(gpu)} of it on the device.`;
  const sorted = Object.entries(passes).sort((a, b) => b[1] - a[1]);
  const most = Math.max(...sorted.map(([, ms]) => ms), 1e-9);
  byId('passes').append(...sorted.map(([name, ms]) => {
    const bar = element('span');
    bar.style.width = `${(100 * ms) / most}%`;
    return element('tr', {}, element('th', { scope: 'row' }, name), element('td', { class: 'number' }, time(ms)),
      element('td', { class: 'number' }, percent(ms / gpu)), element('td', { class: 'bar-cell', 'aria-hidden': 'true' }, bar));
  }));
  if (!sorted.length) byId('time').textContent += ' The device has no timestamps, so passes were not timed.';
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

function svg(name, attributes, text) {
  const found = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  if (text !== undefined) found.textContent = text;
  return found;
}

// One curve a level, coarse to fine side by side: the energies of different levels do not compare.
function energyPlot(width) {
  const height = 250;
  const [left, right, top, bottom] = [58, 8, 22, 34];
  const picture = svg('svg', { viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': 'Energy per valid pixel by outer iteration' });
  const all = report.levels.flatMap((level) => level.energy).filter((e) => e !== null);
  const count = report.levels.reduce((sum, level) => sum + level.energy.length, 0);
  if (!all.length) {
    picture.append(svg('text', { x: 8, y: 24 }, 'No iteration was made.'));
    return picture;
  }
  const [least, most] = [Math.min(...all), Math.max(...all)];
  const [low, high] = [least - 0.05 * (most - least || least || 1), most + 0.05 * (most - least || most || 1)];
  const x = (i) => left + ((i + 0.5) / count) * (width - left - right);
  const y = (e) => top + ((high - e) / (high - low)) * (height - top - bottom);
  const { ticks, digits } = roundTicks(low, high, 7);
  for (const tick of ticks) {
    picture.append(svg('line', { class: 'grid', x1: left, x2: width - right, y1: y(tick), y2: y(tick) }));
    picture.append(svg('text', { x: left - 8, y: y(tick) + 4, 'text-anchor': 'end' }, tick.toFixed(digits)));
  }
  let start = 0;
  report.levels.forEach((level, k) => {
    const end = start + level.energy.length;
    const [from, to] = [x(start - 0.5), x(end - 0.5)];
    if (k % 2 === 0) picture.prepend(svg('rect', { class: 'band', x: from, y: top, width: to - from, height: height - top - bottom }));
    if (to - from > 34) picture.append(svg('text', { x: (from + to) / 2, y: top - 7, 'text-anchor': 'middle' }, to - from > 75 ? `${level.width} × ${level.height}` : level.width));
    const points = level.energy.flatMap((e, i) => (e === null ? [] : [[start + i, e]]));
    picture.append(svg('polyline', { class: 'curve', points: points.map(([i, e]) => `${x(i)},${y(e)}`).join(' ') }));
    for (const [i, e] of points) {
      const dot = svg('circle', { class: 'dot', cx: x(i), cy: y(e), r: 2.5 });
      dot.append(svg('title', {}, `level ${level.width} × ${level.height} px, iteration ${i - start + 1}: ${e.toPrecision(5)}`));
      picture.append(dot);
    }
    start = end;
  });
  picture.append(svg('text', { x: (left + width - right) / 2, y: height - 8, 'text-anchor': 'middle' }, 'outer iteration, levels from coarse to fine; energy per valid pixel'));
  return picture;
}
