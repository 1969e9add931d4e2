"""Tests of the package on lavapipe. Its results must equal those of the program bit for bit."""

import inspect
import multiprocessing
import os
import pickle
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parfocal
from parfocal import inspection, measure

ROOT = Path(__file__).resolve().parents[3]
SIZE = (96, 80)
VALIDATE = os.environ.get("PARFOCAL_VALIDATE") == "1"


def photograph(variance, shift=(0, 0), size=SIZE):
    """Renders waves in all directions, blurred by a Gaussian of this variance (px²) and displaced by `shift`."""
    width, height = size
    x, y = np.meshgrid(np.arange(width) - shift[0], np.arange(height) - shift[1])
    n = 2.4 * np.arange(64)[:, None, None]
    u, v = (0.2 + 0.006 * n) * np.cos(n), (0.2 + 0.006 * n) * np.sin(n)
    waves = np.exp(-variance * (u * u + v * v) / 2) * np.cos(u * x + v * y + n * n)
    return (0.5 + 0.04 * waves.sum(0)).astype(np.float32)


NEAR, FAR = photograph(0.5), photograph(1.5, (0.8, -0.6))


@pytest.fixture(scope="session")
def engine():
    engine = parfocal.Engine(validation=VALIDATE)
    yield engine
    assert engine.messages == []


@pytest.fixture(scope="session")
def result(engine):
    return parfocal.solve(NEAR, FAR, engine=engine)


def as_kind(image, dtype, colour):
    white = {np.uint8: 255, np.uint16: 65535, np.float32: 1}[dtype]
    image = (image * white).round().astype(dtype) if white > 1 else image
    return np.stack([image, image // 2 if white > 1 else image / 2, image], -1) if colour else image


def write(path, image):
    """Writes a PGM, PPM or PFM file."""
    height, width = image.shape[:2]
    if image.dtype == np.float32:
        kind, last, data = ("PF" if image.ndim == 3 else "Pf"), "-1.0", image[::-1].astype("<f4")
    else:
        last = 255 if image.dtype == np.uint8 else 65535
        kind, data = ("P6" if image.ndim == 3 else "P5"), image.astype(image.dtype.newbyteorder(">"))
    path.write_bytes(f"{kind}\n{width} {height}\n{last}\n".encode() + data.tobytes())


def run(*arguments):
    """Runs the program and checks that it succeeds."""
    named = os.environ.get("PARFOCAL_PROGRAM", ROOT / "target/debug/parfocal")
    if not Path(named).exists():
        pytest.fail(f"{named} is missing: run cargo build")
    done = subprocess.run([named, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_solve_recovers_blur_and_registration(result):
    assert result.converged and not result.warnings
    assert abs(np.nanmedian(result.relative_blur) - 1) < 0.05
    assert np.allclose(result.transform[:2, 2], (0.8, -0.6), atol=0.05)
    for field in (result.relative_blur, result.uncertainty, result.confidence, result.residual, result.fused):
        assert field.shape == SIZE[::-1] and field.dtype == np.float32 and field.flags.c_contiguous
        assert np.shares_memory(np.from_dlpack(field), field)
    x = np.array([10, 20, 1])
    moved = result.pixel_transform @ x
    assert np.allclose(moved[:2] / moved[2], (10.8, 19.4), atol=0.05)
    assert result.levels[-1].width == SIZE[0] and len(result.levels[-1].energy) >= 5
    assert "T +0.800 -0.600 px, converged" in repr(result)


def test_solving_without_the_fused_image_does_not_change_other_results(engine, result):
    alone = parfocal.solve(NEAR, FAR, engine=engine, fused=False)
    assert alone.fused is None and "data:image" in alone._repr_html_()
    assert np.array_equal(alone.relative_blur, result.relative_blur, equal_nan=True)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("colour", [False, True])
def test_results_equal_those_of_the_program_bit_for_bit(engine, tmp_path, dtype, colour):
    pair = [as_kind(image, dtype, colour) for image in (NEAR, FAR)]
    files = [tmp_path / f"{n}.{'pfm' if dtype == np.float32 else 'pnm'}" for n in (1, 2)]
    for file, image in zip(files, pair):
        write(file, image)
        read = parfocal.read(file)
        assert read.dtype == dtype and np.array_equal(read, image)
    # Without a lens the exported depth is V. No standard deviation exceeds 1000, so no pixel is left out.
    options = ["--export", "npy", "--max-uncertainty", "1000", "--no-html", "--max-relative-blur", "36", "--motion", "affine"]
    run("solve", *files, "-o", tmp_path / "out", *options)
    found = parfocal.solve(*pair, engine=engine, max_relative_blur=36, motion="affine")
    written = np.load(tmp_path / "out/depth.npy")
    assert written.dtype == np.float32 and written.tobytes() == found.relative_blur.tobytes()
    assert np.load(tmp_path / "out/deviation.npy").tobytes() == found.uncertainty.tobytes()
    assert np.isfinite(written).mean() > 0.5


def test_a_sweep_equals_that_of_the_program(engine, tmp_path):
    frames = [as_kind(photograph(0.3 + (n - 2) ** 2, (0.1 * n, 0)), np.uint16, False) for n in range(5)]
    files = [tmp_path / f"{n}.pnm" for n in range(5)]
    for file, frame in zip(files, frames):
        write(file, frame)
    arguments = ["--positions", "0,1,2,3,4", "--no-html", "--export", "npy"]
    run("stack", *files, "-o", tmp_path / "out", *arguments)
    found = parfocal.stack(frames, engine=engine, positions=range(5))
    assert np.load(tmp_path / "out/depth.npy").tobytes() == found.focus.tobytes()
    assert abs(np.nanmedian(found.focus) - 2) < 0.05 and found.depth is None and found.reference == 2
    assert found.frame.max() <= 5 and len(found.transforms) == 5 and found.order == [0, 1, 2, 3, 4]
    moved = parfocal.apply(frames[4], found, frame=4)
    assert moved.dtype == np.uint16 and moved.shape == frames[4].shape
    stage = parfocal.stack(frames, engine=engine, positions=[0, 0.1, 0.2, 0.3, 0.4], unit="stage")
    assert abs(np.nanmedian(stage.depth) - 0.2) < 0.01 and set(stage.to_xarray()) >= {"depth", "focus"}
    assert "<img" in stage._repr_html_()


def test_memory_layout_does_not_change_results(engine, result):
    def same(i1, i2):
        return parfocal.solve(i1, i2, engine=engine).relative_blur.tobytes() == result.relative_blur.tobytes()

    gaps = np.zeros((SIZE[1], 2 * SIZE[0]), np.float32)
    gaps[:, ::2] = NEAR
    assert same(gaps[:, ::2], np.asfortranarray(FAR))
    assert same(NEAR.astype(">f4"), FAR[..., None])
    read_only = FAR.copy()
    read_only.flags.writeable = False
    assert same(NEAR, read_only)


def test_files_and_other_floats_are_photographs(engine, result, tmp_path):
    files = [tmp_path / "near.pfm", tmp_path / "far.pfm"]
    for file, image in zip(files, (NEAR, FAR)):
        write(file, image)
    found = parfocal.solve(str(files[0]), files[1], engine=engine)
    assert found.relative_blur.tobytes() == result.relative_blur.tobytes()
    doubles = parfocal.solve(NEAR.astype(float), FAR.astype(float), engine=engine)
    assert doubles.relative_blur.tobytes() == result.relative_blur.tobytes()
    with pytest.raises(TypeError, match="give a list"):
        parfocal.stack(str(tmp_path), engine=engine)


def test_a_masked_array_is_solved_where_it_is_not_masked(engine):
    hidden = np.zeros(SIZE[::-1], bool)
    hidden[:, :40] = True
    stated = parfocal.solve(NEAR, FAR, engine=engine, mask=~hidden)
    masked = parfocal.solve(np.ma.array(NEAR, mask=hidden), FAR, engine=engine)
    assert masked.relative_blur.tobytes() == stated.relative_blur.tobytes()
    unknown = np.where(hidden, np.nan, NEAR)
    both = parfocal.solve(np.ma.masked_invalid(unknown), FAR, engine=engine, mask=np.ma.array(~hidden, mask=hidden))
    assert np.isnan(both.relative_blur[:, :40]).all() and np.isfinite(both.relative_blur[40, 60])


def test_floats_beyond_black_and_white_are_warned_of(engine):
    with pytest.warns(UserWarning, match="i2 has values from .* to .*, and floats have white at 1") as caught:
        parfocal.register(np.clip(NEAR, 0, 1), 255 * FAR, engine=engine, outer_iterations=5)
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_fused_image_has_the_type_of_the_photographs(engine, dtype):
    image = as_kind(np.clip(NEAR, 0, 1), dtype, True)
    same = parfocal.solve(image, image, engine=engine, outer_iterations=5).fused_image
    assert same.dtype == dtype and same.shape == image.shape
    white = 255 if dtype == np.uint8 else 65535 if dtype == np.uint16 else 1
    assert np.median(np.abs(same.astype(float) - image)) < 0.01 * white
    assert parfocal.solve(image, image, engine=engine, outer_iterations=5, fused=False).fused_image is None


def test_every_setting_is_a_keyword_argument(engine, result):
    defaults = dict(
        method="unified",
        levels="auto",
        outer_iterations=100,
        relaxation_sweeps=3,
        over_relaxation=1.3,
        regularization=None,
        continuation=10,
        data_eta=0.01,
        smoothness_eta=0.1,
        max_relative_blur=144.0,
        largest_step=1,
        kernel="auto",
        motion="similarity",
        registration_step="gauss-newton",
        photometric=True,
        edges=True,
        parallax="auto",
        fused=True,
        keep_frames=False,
        decode="auto",
        black_level=None,
        white_level=None,
        start=np.eye(3),
        start_photometric=(1, 0),
    )
    assert defaults.keys() == parfocal._solves._NAMES
    found = parfocal.solve(NEAR, FAR, engine=engine, **defaults)
    assert found.relative_blur.tobytes() == result.relative_blur.tobytes()
    y, x = np.mgrid[-4:5, -4:5]
    disk = parfocal.solve(NEAR, FAR, engine=engine, kernel=x * x + y * y <= 16, max_relative_blur=9, levels=1)
    assert disk.kernel_shape is None and result.kernel_shape is not None and disk.max_relative_blur == 9


def test_region_mask_and_cropping(engine, result):
    part = parfocal.solve(NEAR, FAR, engine=engine, region=(20, 10, 40, 30), max_relative_blur=9)
    assert part.relative_blur.shape == (30, 40) and part.region == (20, 10, 40, 30) and part.photograph == SIZE
    data = part.to_xarray()
    assert data.relative_blur.units == "px2" and int(data.x[0]) == 20 and int(data.y[-1]) == 39
    assert np.shares_memory(data.relative_blur.values, part.relative_blur)
    mask = np.ones(SIZE[::-1], bool)
    mask[:, :40] = False
    masked = parfocal.solve(NEAR, FAR, engine=engine, mask=mask)
    assert np.isnan(masked.relative_blur[:, :40]).all() and np.isfinite(masked.relative_blur[40, 60])
    cropped = parfocal.solve(NEAR, FAR, engine=engine, crop_valid=True)
    assert np.isfinite(cropped.relative_blur).all() and cropped.relative_blur.shape < SIZE[::-1]


def test_registration_and_other_photographs(engine, result):
    found = parfocal.register(NEAR, FAR, engine=engine)
    assert np.allclose(found.transform[:2, 2], (0.8, -0.6), atol=0.05) and found.converged
    sharp = photograph(0.5, (0.8, -0.6))
    moved = parfocal.apply(sharp, found)
    assert moved.dtype == np.float32 and np.abs(moved - NEAR)[10:-10, 10:-10].max() < 0.02
    assert np.abs(parfocal.apply(sharp, result, exposure=True) - NEAR)[10:-10, 10:-10].max() < 0.03
    start = parfocal.solve(NEAR, FAR, engine=engine, method="aligned", start=found.transform)
    assert np.array_equal(start.transform, found.transform)
    with pytest.raises(ValueError, match="registered photographs"):
        parfocal.apply(sharp[:50], found)


def test_depth_and_measures(result):
    lens = parfocal.Lens(50, 4, 0.0075, (300, 310), telecentric=True)
    found = result.depth(lens)
    assert found.depth.shape == result.relative_blur.shape and 300 < np.nanmedian(found.depth) < 310
    ramp = np.fromfunction(lambda y, x: 0.5 * x - 0.25 * y, (30, 40), dtype=np.float32)
    assert abs(measure.step(ramp, (2, 2, 11, 11), (22, 2, 11, 11)).value - 10) < 1e-4
    assert abs(measure.level(ramp, (10, 4, 21, 11)).value - 7.75) < 1e-4
    assert np.allclose(measure.profile(ramp, (0, 0), (20, 0)), 0.5 * np.arange(21))
    assert measure.level(np.full((9, 9), np.nan), (0, 0, 5, 5)) is None
    with pytest.raises(ValueError, match="not within the image"):
        measure.level(ramp, (30, 0, 20, 5))
    for wrong, words in [((-1, 4, 0.0075, (300, 310)), "focal length"), ((50, 4, 0.0075, (30, 310)), "focal length, 50 mm")]:
        with pytest.raises(ValueError, match=words):
            parfocal.Lens(*wrong)
    assert "did you mean a pixel pitch of 0.0075 mm" in result.depth(parfocal.Lens(50, 4, 7.5, (300, 310))).warning


def test_parts_are_judged_without_files(result):
    def part(bump=0.0, seed=0):
        noise = np.random.default_rng(seed).normal(0, 0.02, result.relative_blur.shape)
        height, width = noise.shape
        noise[height // 2 - 6 : height // 2 + 6, width // 2 - 6 : width // 2 + 6] += bump
        whole = inspection.Part.of(result)
        return replace(whole, values=(whole.values + noise).astype(np.float32))

    golden = inspection.teach([part(seed=n) for n in range(3)], tolerance=1)
    assert golden.inspect(part(seed=5), serial="SN1").verdict == "go"
    found = golden.inspect(part(4, seed=6), serial="SN2")
    assert (found.verdict, found.report["serial"], len(found.report["regions"])) == ("no-go", "SN2", 1) and found.seconds >= 0
    assert "deviates at one place" in found.reasons[0] and found.difference.shape == result.relative_blur.shape
    stopped = replace(part(seed=7), faults=("its solve had not converged",))
    assert golden.inspect(stopped).verdict == "cannot-judge"
    with pytest.raises(ValueError, match="less than the taught"):
        golden.inspect(part(), tolerance=0.1)
    with pytest.raises(ValueError, match="good part 3 disagrees"):
        inspection.teach([part(seed=n) for n in range(3)] + [part(4)], tolerance=1)
    with pytest.raises(ValueError, match="good part 3 disagrees"):
        inspection.teach([part(seed=n) for n in range(3)] + [part(4)])


def test_roughness_of_known_waves(result):
    # Waves of amplitude 2 mm and 32 px, of pixels of 0.5 mm: Sq is 2 / sqrt(2), Sa 4 / pi, Sdq 2 pi / 16 times Sq.
    waves = np.fromfunction(lambda y, x: 2 * np.cos((x + 0.5) * np.pi / 16) + 0.01 * x, (64, 128))
    deviation = np.full(waves.shape, 0.02)
    found = measure.roughness(waves, deviation, pixel_size=0.5)
    assert (found.area_px, found.measured_px, found.str_is_upper_bound) == (64 * 128, 64 * 128, True)
    known = {"Sq": 2**0.5, "Sa": 4 / np.pi, "Sdq": 2**0.5 * np.pi / 8, "Ra": 4 / np.pi, "Sku": 1.5}
    for symbol, value in known.items():
        assert abs(found[symbol].value / value - 1) < 0.02, (symbol, found[symbol])
    assert 0 < found["Sq"].standard_deviation < 0.02 and found["Sq"].by_scale is None
    common = 0.1 * waves
    both, line = np.hypot(deviation, common), ((0, 9), (127, 9))
    scaled = measure.roughness(waves, both, common=common, line=np.array(line), realizations=5)
    assert abs(scaled["Sq"].by_scale / scaled["Sq"].value - 0.1) < 1e-3 and scaled.profiles == 1
    assert abs(scaled["Sq"].by_noise) < 0.01 and np.isnan(scaled["Sdr"].value)
    options = {"region": (0, 0, 64, 64), "mask": waves < 9, "s_filter": 4, "l_filter": 60, "form": "none"}
    part = measure.roughness(waves, deviation, **options)
    assert part.area_px == 64 * 64 and 0.5 < part["Sq"].value < 1.5
    masked = np.ma.masked_less(waves, 0)
    assert measure.roughness(masked, deviation).measured_px == np.sum(waves >= 0)
    v, scale = result.relative_blur, result.scale_deviation * result.relative_blur
    assert measure.roughness(v, result.uncertainty, common=scale)["Sa"].value > 0
    for options, words in [
        ({"form": "sphere"}, "none, plane, quadric or cylinder"),
        ({"s_filter": 1}, "at least 4 px"),
        ({"realizations": 1}, "give 2 to 10000"),
        ({"pixel_size": -1}, "size of a pixel"),
        ({"noise_window": np.nan}, "noise window"),
        ({"common": waves[1:]}, "8064 pixels for 8192"),
        ({"region": (0, 0, 999, 9)}, "not within"),
    ]:
        with pytest.raises(ValueError, match=words):
            measure.roughness(waves, deviation, **options)


def test_repeated_measurements():
    rng = np.random.default_rng(3)
    part = np.fromfunction(lambda y, x: np.sin(x / 9) + y / 50, (96, 128))
    maps = [part + 0.1 * rng.standard_normal(part.shape) + n for n in range(4)]
    sigmas = [np.full(part.shape, 0.1)] * 4
    found = measure.repeated_maps(maps, sigmas)
    assert abs(found.noise.value - 0.1) < 4 * found.noise.standard_error < 0.01
    assert abs(found.seen_over_stated.value - 1) < 0.05 and abs(found.within[0].value - 0.683) < 0.02
    assert abs(found.shift_deviation.value - 1.291) < 0.01
    assert found.repeatability_limit.value == 2.8 * found.noise.value
    part = measure.repeated_maps(maps, sigmas, form="plane", region=(0, 0, 64, 96), mask=maps[0] > -9)
    assert part.area_px == 64 * 96
    with pytest.raises(ValueError, match="cylinder"):
        measure.repeated_maps(maps, sigmas, form="cylinder")
    with pytest.raises(ValueError):
        measure.repeated_maps(maps, sigmas[1:])
    values = 5 + 0.01 * rng.standard_normal(30)
    scatter = measure.readings(values, true_value=5, tolerance_width=0.5)
    assert scatter.count == 30 and np.isclose(scatter.standard_deviation.value, np.std(values, ddof=1))
    assert scatter.standard_deviation.low < 0.01 < scatter.standard_deviation.high
    assert scatter.bias.low < 0 < scatter.bias.high
    assert np.isclose(scatter.cg.value, 0.1 / (6 * scatter.standard_deviation.value))
    assert measure.readings([1, 2]).cg is None and measure.readings([1, 1], 1, 1).cg is None
    with pytest.raises(ValueError, match="both"):
        measure.readings(values, 5)
    for width in (0, -1, np.nan, np.inf):
        with pytest.raises(ValueError, match="tolerance_width"):
            measure.readings(values, 5, width)
        with pytest.raises(ValueError, match="tolerance_width"):
            measure.gauge_study(np.zeros((2, 2, 2)), width)
    study = rng.standard_normal((1, 10, 1)) + 0.1 * rng.standard_normal((3, 10, 3))
    found = measure.gauge_study(study, tolerance_width=6)
    by_name = {row["name"]: row for row in found["components"]}
    assert 0.05 < by_name["gauge R&R"]["standard_deviation"]["value"] < 0.2 and found["categories"]["value"] > 5
    with pytest.raises(ValueError, match="operators x parts x trials"):
        measure.gauge_study(values)


def test_a_result_has_html_and_can_be_pickled(result):
    page = result._repr_html_()
    assert page.count("data:image/png;base64,") == 2 and "converged" in page
    back = pickle.loads(pickle.dumps(result))
    assert back.relative_blur.tobytes() == result.relative_blur.tobytes() and back.brightness.gain == result.brightness.gain


@pytest.mark.parametrize(
    ("error", "words", "arguments"),
    [
        (TypeError, "convert it to uint8, uint16 or floats", {"i1": (255 * NEAR).astype(int)}),
        (ValueError, "repeats its pixels", {"i1": np.broadcast_to(np.float64(0.5), (10**6, 10**6))}),
        (ValueError, "i2 is masked", {"i2": np.ma.masked_less(FAR, 0.5)}),
        (ValueError, "remove the alpha channel", {"i1": np.zeros((80, 96, 4), np.uint8)}),
        (ValueError, "its shape is", {"i2": np.zeros(5, np.uint8)}),
        (ValueError, "must have the same size|96x80", {"i2": FAR[:70]}),
        (ValueError, "not a number", {"i2": np.full_like(FAR, np.nan)}),
        (TypeError, "did you mean max_relative_blur", {"max_relativ_blur": 3}),
        (ValueError, "max_relative_blur is 2000", {"max_relative_blur": 2000}),
        (ValueError, "give unified, aligned, appearance", {"method": "sift"}),
        (TypeError, "levels='many'", {"levels": "many"}),
        (ValueError, "not invertible", {"start": np.zeros((3, 3))}),
        (ValueError, "region", {"region": (90, 0, 20, 20)}),
        (ValueError, "mask is", {"mask": np.ones((4, 4))}),
    ],
)
def test_invalid_arguments_are_reported(engine, error, words, arguments):
    with pytest.raises(error, match=words):
        parfocal.solve(**{"i1": NEAR, "i2": FAR, "engine": engine} | arguments)


@pytest.mark.parametrize("page", ["docs/guide/src/python.md", "bindings/python/README.md"])
def test_examples_of_the_guide_run(engine, page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Calls without an engine use the engine with validation.
    monkeypatch.setattr(parfocal._solves, "_default", engine)
    size = (320, 160)
    pair = {"near": photograph(0.5, size=size), "far": photograph(1.5, (0.8, -0.6), size)}
    for name, image in pair.items():
        np.save(f"{name}.npy", image)
    sweep = [photograph(0.3 + (n - 2) ** 2, (0.1 * n, 0)) for n in range(4)]
    names = pair | {"other": pair["far"], "frames": sweep}
    blocks = (ROOT / page).read_text().split("```python\n")[1:]
    # test_ray.py runs the blocks that use a cluster.
    shown = [block.split("```")[0] for block in blocks if "parfocal.ray" not in block]
    exec("".join(shown), names)
    assert names["result"].converged


def test_unreadable_files_are_reported(tmp_path):
    for missing in ("none.png", "none.tif#2", "none.raw#Mono8:4x4"):
        with pytest.raises(FileNotFoundError, match=missing.split("#")[0]):
            parfocal.read(tmp_path / missing)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(ValueError, match="text.png"):
        parfocal.read(tmp_path / "text.png")


def test_devices_are_listed_and_unknown_ones_are_refused():
    assert any(reason is None for _, reason in parfocal.devices())
    with pytest.raises(parfocal.DeviceError, match="no such thing"):
        parfocal.Engine("no such thing")
    assert parfocal.Engine(0).name == parfocal.devices()[0][0]
    with pytest.raises(parfocal.DeviceError, match="99"):
        parfocal.Engine(99)


def test_other_threads_run_during_a_solve(engine):
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.002):
            ticks.append(time.monotonic())

    thread = threading.Thread(target=tick)
    thread.start()
    began = time.monotonic()
    # The solve takes long enough for the other thread to run if it can.
    parfocal.solve(photograph(0.5, size=(480, 320)), photograph(1.5, size=(480, 320)), engine=engine)
    ended = time.monotonic()
    done.set()
    thread.join()
    assert sum(began < tick < ended for tick in ticks) >= 3


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_child_gets_an_error(engine):
    child = os.fork()
    if child == 0:
        try:
            parfocal.solve(NEAR, FAR, engine=engine)
        except parfocal.DeviceError as error:
            os._exit(0 if "spawn" in str(error) else 1)
        os._exit(2)
    assert os.waitpid(child, 0)[1] == 0


def blur_on_the_cpu():
    return parfocal.solve(NEAR, FAR, engine=parfocal.Engine("cpu")).relative_blur


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork")
def test_a_forked_child_can_open_the_cpu_device():
    """The threads that waited for work in the parent do not exist in the child."""
    parfocal.solve(NEAR, FAR)
    expected = blur_on_the_cpu()
    with multiprocessing.get_context("fork").Pool(1) as pool:
        found = pool.apply_async(blur_on_the_cpu).get(timeout=100)
        with pytest.raises(parfocal.DeviceError, match="spawn"):
            pool.apply_async(parfocal.solve, (NEAR, FAR)).get(timeout=100)
    assert found.tobytes() == expected.tobytes()


def test_memory_does_not_grow_with_the_number_of_pairs(engine):
    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def some(count):
        for _ in range(count):
            parfocal.register(NEAR, FAR, engine=engine, outer_iterations=5)

    some(3)
    before = resident()
    some(int(os.environ.get("PARFOCAL_PAIRS_OF_MEMORY", "20")))
    assert resident() - before < 8 << 20


def test_the_type_of_the_settings_has_every_setting():
    assert set(parfocal._solves.Settings.__annotations__) == {name for name, *_ in parfocal._native.setting_table()}


def test_the_settings_are_documented():
    for text in (parfocal.Settings.__doc__, parfocal.solve.__doc__, parfocal.stack.__doc__):
        assert "    max_relative_blur: " in text and "Range: px², 1 to 1024. Default: auto." in text
        assert "    edges: " in text and "Default: True." in text
    for kind in (parfocal.Result, parfocal.Sweep, parfocal.Registration):
        source = inspect.getsource(kind)
        for name in kind.__dict__.get("__annotations__", {}):
            after = source.split(f"    {name}: ", 1)[1].split("\n", 2)[1]
            assert after.strip().startswith('"""'), f"{kind.__name__}.{name}"
