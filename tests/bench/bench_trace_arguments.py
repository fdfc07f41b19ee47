#!/usr/bin/env python3
"""bench_trace says what is wrong with its options and files, and its exit status is what its header says.

usage: bench_trace_arguments.py BENCH
"""
import pathlib
import struct
import subprocess
import sys
import tempfile

PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""
RAY = struct.pack("<8f", 0.2, 0.2, -1, 0, 0, 0, 1, 9)
CASES = [  # options, the rays file, exit status, what standard error says
    (["--runs", "x"], None, 2, '--runs: expected a whole number from 1 to 99, not "x"'),
    (["--runs", "0"], None, 2, '--runs: expected a whole number from 1 to 99, not "0"'),
    (["--runs", "7x"], None, 2, 'not "7x"'),
    (["--runs", "100"], None, 2, 'not "100"'),
    (["--side", ""], None, 2, '--side: expected a whole number from 16 to 16384, not ""'),
    (["--side", "15"], None, 2, 'not "15"'),
    (["--side", "99999999999999999999"], None, 2, "--side"),
    (["--scene", "nosuch"], None, 2, "usage"),
    (["--mesh", "m.ply"], None, 2, "usage"),
    (["--rays", "none"], None, 2, "usage"),
    ([], struct.pack("<I", 1) + RAY, 0, ""),
    ([], struct.pack("<I", 0), 3, "no ray to be timed"),
    ([], struct.pack("<I", 1) + struct.pack("<8f", *[float("nan")] * 8), 3, "no ray to be timed"),
    ([], b"", 3, "expected a count"),
    ([], struct.pack("<I", 2) + RAY, 3, "expected a count and 8 floats for each ray: 68 bytes for 2 rays, not 36"),
    ([], struct.pack("<I", 1) + RAY + b"x", 3, "not 37"),
    ([], struct.pack("<I", 0xffffffff) + RAY, 3, "not 36"),
]


def main():
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        ply, rays = pathlib.Path(folder, "m.ply"), pathlib.Path(folder, "rays")
        ply.write_bytes(PLY)
        for options, data, status, text in CASES:
            if data is not None:
                rays.write_bytes(data)
                options = ["--quick", "--runs", "1", "--mesh", ply, "--rays", rays]
            elif "--scene" not in options:
                options = options + ["--scene", "nosuch"]  # whatever it thinks of the others, nothing is timed
            done = subprocess.run([sys.argv[1], *map(str, options)], capture_output=True, text=True)
            if done.returncode != status or text not in done.stderr:
                print(f"{options} {data}: status {done.returncode}, not {status}; {done.stderr}")
                wrong += 1
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
