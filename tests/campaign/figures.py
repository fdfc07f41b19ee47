#!/usr/bin/env python3
"""figures.py FIGURES.jsonl... : the tables of docs/RELIABILITY.md, from what the campaigns wrote.

"0 of N" with no failure seen means: at 95 % confidence fewer than 3/N of all such trials fail (the
rule of three). A campaign that fails writes no figure and ends: what is counted here held.
"""
import json
import sys


def bound(count):
    """`0 of 1,000 (at most 0.3 % at 95 %)`"""
    return f"0 of {count:,} (at most {300 / count:.2g} % at 95 %)" if count else "none tried"


def total(rows, field):
    return sum(row[field] for row in rows)


def times(rows, field="recovery_s"):
    """Weighted by nothing: median of medians, worst maximum."""
    medians = sorted(row[field]["median"] for row in rows)
    return f"{medians[len(medians) // 2]:.2f} s, longest {max(row[field]['max'] for row in rows):.1f} s"


def main():
    rows = []
    for path in sys.argv[1:]:
        with open(path, encoding="ascii") as file:
            rows += [json.loads(line) for line in file]
    of = {}
    for row in rows:
        of.setdefault(row["kind"], []).append(row)
    kills, masters, steps = of.get("kill-worker", []), of.get("kill-master", []), of.get("disk-step", [])
    killed = [row for row in steps if row["action"] in ("kill", "killed", "torn")]
    failed = [row for row in steps if row["action"] in ("ENOSPC", "EIO")]
    print("| trial | wrong, lost or crashed |\n|---|---|")
    print(f"| SIGKILL of a worker at a random moment | {bound(total(kills, 'kills'))} |")
    print(f"| SIGKILL of the master at a random moment | {bound(total(masters, 'kills'))} |")
    print(f"| SIGKILL of the master before, after or in the middle of a step of its disk | {bound(total(killed, 'runs'))} |")
    print(f"| a step of the master's disk that fails (ENOSPC, EIO) | {bound(total(failed, 'runs'))} |")
    for row in of.get("allocation", []):
        print(f"| one allocation of the {row['program']} fails ({row['allocations']}, of {row['total']:,}) | {bound(row['runs'])} |")
    orders = of.get("orders", [])
    if orders:
        print(f"| an order of somebody who changes their mind, at a random moment of six jobs | {bound(total(orders, 'orders'))} |")
    network = of.get("network", [])
    if network:
        print(f"| a farm behind a faulty network ({len(network)} faults) | {bound(total(network, 'runs'))} |")
    print(f"| a simulated farm (a seed each) | {bound(total(of.get('simulation', []), 'seeds'))} |")
    fuzz = [row for row in of.get("fuzz", []) if row["findings"] == 0]
    print(f"| hostile input ({len({row['target'] for row in fuzz})} targets, {total(fuzz, 'cpu_seconds') / 3600:.2f} CPU-hours) | {bound(total(fuzz, 'runs'))} |")
    for row in of.get("identity", []):
        print(f"| a render of one scene by {row['builds']} builds, over cells, workers, threads, FMA | {bound(row['renders'])} |")
    print("\n| figure | value |\n|---|---|")
    if kills:
        print(f"| units of a killed worker are with others after | {times(kills)} |")
        print(f"| units leased again, of all that were rendered, with a kill every quarter of a second | {total(kills, 'retried'):,} of {total(kills, 'units'):,} |")
    if masters:
        shares = sorted(row["rendered_share"] for row in masters)
        print(f"| first result stored by a new master after the kill of the old one | {times(masters)} |")
        print(f"| samples rendered, of samples needed, with a kill of the master every half a second | {shares[0]:.2f} to {shares[-1]:.2f} |")
    for row in of.get("slow-connections", []):
        if "master_core_share" in row:
            print(f"| processor time of the master for {row['connections']:,} strangers at 1 byte/s | {100 * row['master_core_share']:.1f} % of a core |")
        print(f"| throughput of good workers beside {row['connections']:,} strangers at 1 byte/s | {row['throughput_median']:.2f} ({row['throughput_min']:.2f} to {row['throughput_max']:.2f}) of that without |")
        print(f"| memory of the master with them | {row['master_mb']:.0f} MB, {row['master_quiet_mb']:.0f} MB without |")


if __name__ == "__main__":
    main()
