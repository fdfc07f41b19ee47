"""Commands of `run` (which see)."""
import argparse
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import mitsuba as mi
import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SEEDS = 16


def choose_variant(name):
    try:
        mi.set_variant(name)
    except Exception as error:  # LLVM is loaded at the first use
        sys.exit(f"run: Mitsuba's {name} does not start: {error} (apt: libllvm19)")


def theirs(scene_map, spp, seeds, first=0, **options):
    """Pictures of Mitsuba, one a seed."""
    scene = mi.load_dict(scene_map.dict(**options))
    for seed in range(seeds):
        yield np.array(mi.render(scene, spp=spp, seed=first + seed))


def ours(tilery, path, size, spp, seeds, extra):
    """Pictures of Tilery, one a seed."""
    with tempfile.TemporaryDirectory() as folder:
        out = str(pathlib.Path(folder) / "out.exr")
        for seed in range(seeds):
            command = [tilery, "render", str(path), "-o", out, "--quiet", "--seed", str(seed),
                       "--spp", str(spp), "--size", f"{size[0]}x{size[1]}", *extra]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                sys.exit(f"run: {' '.join(command)} ended with {done.returncode}: {done.stderr}")
            bitmap = mi.Bitmap(out)  # held while its memory is copied
            yield np.array(bitmap)[:, :, :3].copy()


def write_exr(path, pixels):
    mi.Bitmap(np.ascontiguousarray(pixels, dtype=np.float32)).write(str(path))


def size_of(text):
    width, height = (int(part) for part in text.split("x"))
    if width % 8 or height % 8 or width < 8 or height < 8:
        raise argparse.ArgumentTypeError("width and height are multiples of 8")
    return width, height


def compare(options):
    import block_test
    from scene_map import NotMapped, SceneMap
    failures = 0
    for path in options.scenes:
        try:
            scene_map = SceneMap(path, options.size)
            pictures = [list(theirs(scene_map, options.peer_spp or options.spp, options.seeds))]
        except NotMapped as reason:
            print(f"{path}: not compared: {reason}", flush=True)
            continue
        pictures.append(list(ours(options.tilery, path, options.size, options.spp, options.seeds,
                                  options.extra)))
        blocks = [[block_test.blocks_of(p.astype(float)) for p in side] for side in pictures]
        verdict = block_test.Verdict(blocks[1], blocks[0])
        print(f"{path}: {verdict}", flush=True)
        if verdict.agrees() and not options.keep:
            continue
        failures += not verdict.agrees()
        folder = pathlib.Path(options.output)
        folder.mkdir(parents=True, exist_ok=True)
        stem = pathlib.Path(path).stem
        means = [np.mean(side, axis=0) for side in pictures]
        write_exr(folder / f"{stem}.theirs.exr", means[0])
        write_exr(folder / f"{stem}.ours.exr", means[1])
        write_exr(folder / f"{stem}.difference.exr", means[1] - means[0])
        board = np.concatenate([means[0], means[1],
                                0.2 + 2 * (means[1] - means[0]) / (means[0] + means[0].mean())], 1)
        mi.util.write_bitmap(str(folder / f"{stem}.png"), np.clip(board, 0, 1).astype(np.float32))
    return 1 if failures else 0


def random_scenes(options):
    import random_scenes as drawn
    options.scenes = drawn.write(options.output, options.first, options.count)
    return compare(options)


def references(options):
    import block_test
    from scene_map import SceneMap
    (HERE / "references").mkdir(exist_ok=True)
    for path in sorted((HERE / "scenes").glob("*.json")):
        if options.names and path.stem not in options.names:
            continue
        scene_map = SceneMap(path)
        total, blocks = 0, []
        for picture in theirs(scene_map, options.spp, SEEDS):
            total = total + picture.astype(float)
            blocks.append(block_test.blocks_of(picture.astype(float)))
        variance = np.var(blocks, axis=0, ddof=1) / SEEDS
        variance = variance.repeat(block_test.BLOCK, axis=0).repeat(block_test.BLOCK, axis=1)
        whole = np.var([b.mean() for b in blocks], ddof=1) / SEEDS
        pixels = np.concatenate([total / SEEDS, variance, np.full_like(total[:, :, :1], whole)],
                                axis=2).astype(np.float32)
        names = ["R", "G", "B", "variance.R", "variance.G", "variance.B", "variance.all"]
        bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names)
        bitmap.write(str(HERE / "references" / f"{path.stem}.exr"))
        print(path.stem, "mean", (total / SEEDS).mean(), flush=True)
    return 0


def bench(options):
    """Answers "SPP SEED" lines with the time and the picture, for tests/bench/render_peer.h."""
    import drjit as dr
    from scene_map import SceneMap
    # What else writes to the standard output goes to the standard error.
    reply = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    mi.set_log_level(mi.LogLevel.Error)
    scene_map = SceneMap(options.scene, options.size)
    # Roulette after five edges, Mitsuba's default; it is the faster choice.
    scene = mi.load_dict(scene_map.dict(sampler=options.sampler, rr_depth=5))
    dr.set_thread_count(options.threads)
    known = set()
    reply.write(b"ready\n")
    reply.flush()
    for line in sys.stdin:
        spp, seed = (int(word) for word in line.split())
        # A kernel is compiled for each number of samples: not counted.
        if spp not in known:
            np.array(mi.render(scene, spp=spp, seed=seed + 1))
            known.add(spp)
        begin, begin_cpu = time.monotonic(), time.process_time()
        picture = np.array(mi.render(scene, spp=spp, seed=seed), dtype=np.float32)
        reply.write(f"{time.monotonic() - begin} {time.process_time() - begin_cpu}\n".encode())
        reply.write(picture.tobytes())
        reply.flush()
    return 0


def main():
    parser = argparse.ArgumentParser(prog="run")
    commands = parser.add_subparsers(dest="command", required=True)
    c = commands.add_parser("compare", help="hold scene files against Mitsuba")
    c.add_argument("scenes", nargs="+")
    d = commands.add_parser("random", help="hold scenes drawn from seeds against Mitsuba")
    d.add_argument("count", type=int)
    d.add_argument("--first", type=int, default=1, help="the first one's seed (1)")
    for p in (c, d):
        p.add_argument("--size", type=size_of, default=(64, 64))
        p.add_argument("--spp", type=int, default=64, help="a seed (64)")
        p.add_argument("--peer-spp", type=int, help="of Mitsuba; default as --spp")
        p.add_argument("--seeds", type=int, default=SEEDS)
        p.add_argument("--tilery", default=str(ROOT / "build/release/bin/tilery"))
        p.add_argument("--variant", default="llvm_ad_rgb")
        p.add_argument("--output", default="mitsuba-differences",
                       help="folder of the pictures of those that differ")
        p.add_argument("--keep", action="store_true", help="write all pictures")
        p.add_argument("--extra", nargs="*", default=[], help="options for tilery render")
    r = commands.add_parser("references", help="render the kept references")
    r.add_argument("names", nargs="*")
    r.add_argument("--spp", type=int, default=256, help="a seed (256)")
    r.add_argument("--variant", default="llvm_ad_rgb")
    b = commands.add_parser("bench", help="the peer of bench_render")
    b.add_argument("scene")
    b.add_argument("--size", type=size_of, required=True)
    b.add_argument("--threads", type=int, default=2)
    b.add_argument("--variant", default="llvm_ad_rgb")
    b.add_argument("--sampler", default="multijitter")
    commands.add_parser("scenes", help="write the scenes anew")
    options = parser.parse_args()
    if options.command == "scenes":
        import make_scenes
        return make_scenes.main()
    choose_variant(options.variant)
    return {"compare": compare, "random": random_scenes, "references": references,
            "bench": bench}[options.command](options)


sys.exit(main())
