#!/usr/bin/env python3
"""Tables of studies in Markdown: how often less work than the base, and what bias, for each setting.

usage: tradeoff_table.py STUDY_DIR...
"""
import json
import pathlib
import sys


def figure(v):
    if v is None:
        return "-"
    return f"{v:.2g}" if abs(v) < 0.1 else f"{v:.2f}" if abs(v) < 10 else f"{v:.0f}"


def gain(p):
    g = p["gain"]
    if g["value"] is None:
        return "-"
    text = f"{figure(g['value'])} ({figure(g['low'])} to {figure(g['high'])})"
    biased = p["bias2_se"] is not None and p["bias2"] > 2 * p["bias2_se"] and p["bias2"] > 1e-5
    return text + (f", bias² {figure(p['bias2'])}" if biased else "")


def cell(p, base):
    if p is None or p["repeats"] < 2:
        return ""
    if p["knob"] == "output":
        change = p["relmse"]["value"] / base["relmse"]["value"] - 1
        return f"{figure(p['file_bytes'] / base['file_bytes'])} of the bytes, relMSE {change:+.1e} of it"
    if p["knob"] == "target-error":
        return gain(p) + f", mean {p['spp_mean']:.0f} spp"
    return gain(p) + (", same bits" if p["same_bits"] else "")


def main():
    studies = [(pathlib.Path(d).name, json.loads((pathlib.Path(d) / "tradeoff.json").read_text()))
               for d in sys.argv[1:]]
    print("| | " + " | ".join(name for name, _ in studies) + " |")
    print("|---" * (len(studies) + 1) + "|")
    rows = [("size, base", [f"{s['width']}x{s['height']}, {s['base_spp']} spp" for _, s in studies]),
            ("core-seconds, relMSE of the base",
             [next(f"{figure(p['core_seconds']['value'])}, {figure(p['relmse']['value'])}"
                   for p in s["points"] if p["base"]) for _, s in studies]),
            ("relMSE of the references", [figure(s["reference"]["relmse"]) for _, s in studies]),
            ("set-up core-seconds: " + ", ".join(studies[0][1]["setup_core_seconds"]),
             [", ".join(figure(v) for v in s["setup_core_seconds"].values()) for _, s in studies])]
    for name, cells in rows:
        print(f"| {name} | " + " | ".join(cells) + " |")
    seen = []
    for _, s in studies:
        for p in s["points"]:
            key = (p["knob"], p["value"])
            if p["knob"] not in ("spp", "preset") and key not in seen:
                seen.append(key)
    knobs = list(dict.fromkeys(k for k, _ in seen))
    seen.sort(key=lambda k: (knobs.index(k[0]), float(k[1]) if k[1].replace(".", "").isdigit() else 0))
    for knob, value in seen:
        cells = [cell(next((p for p in s["points"] if (p["knob"], p["value"]) == (knob, value)), None),
                      next(p for p in s["points"] if p["base"])) for _, s in studies]
        print(f"| {knob} {value} | " + " | ".join(cells) + " |")
    for level in range(3):
        cells = []
        for _, s in studies:
            p = s["presets"][level]
            options = ", ".join(f"{k} {v}" for k, v in p["options"].items())
            cells.append(f"{options}: {figure(p['relmse'])}{'' if p['measured'] else ' expected'}")
        print(f"| {studies[0][1]['presets'][level]['name']} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
