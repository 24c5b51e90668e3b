"""Domain to skeletons, and the cut alone, beside the paper's published figures (appendices A and B).

    .venv/bin/python benchmarks/cut.py [--domain FILE --spec FILE] [--out FOLDER] [--quick] [--cpu-time]

Prints the tables, writes ``cut.json`` and the convergence plot ``cut_convergence.png``. The default domain is the
project's U-bend; ``--domain`` takes any other with its specification.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh

from dualms.cut.anneal import anneal
from dualms.cut.bound import upper_bound
from dualms.cut.constraints import cut_weight, problem_of, violations
from dualms.cut.greedy import greedy
from dualms.cut.partition import PROPOSALS_PER_SECOND, max_cut
from dualms.cut.start import first_partition
from dualms.domain import Domain
from dualms.flow import flow_field
from dualms.graph.graph import Graph, site_graph
from dualms.mesh import DomainMesh
from dualms.ports import resolve_ports
from dualms.reading import read_domain_mesh
from dualms.skeletons import skeletons
from dualms.spec import FluidsSpec, GraphSpec, PartitionSpec, PotentialFlow, Spec, Unit

ROOT = Path(__file__).parents[1]
# Paper, table of appendix A: points, graph initialisation (s), constrained connected maximum cut (s); RTX 3090 host.
PUBLISHED = {300: (3.1668, 0.0121), 400: (3.4427, 0.0180), 500: (2.9378, 0.0326), 600: (3.1368, 0.0432),
             800: (3.7321, 0.0647)}  # fmt: skip
CONVERGENCE = (100, 300, 500, 1000)  # paper, figure of appendix B
CLOCK = time.perf_counter
T = TypeVar("T")


def timed(action: Callable[[], T]) -> tuple[T, float]:
    """A result and the seconds it took."""
    start = CLOCK()
    result = action()
    return result, CLOCK() - start


def main() -> None:
    """Run all parts."""
    global CLOCK
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", type=Path, default=ROOT / "examples" / "u_bend.stl")
    parser.add_argument("--spec", type=Path, default=ROOT / "examples" / "u_bend.json")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results")
    parser.add_argument("--cpu-time", action="store_true", help="seconds of this process, for a busy machine")
    parser.add_argument("--quick", action="store_true", help="small sizes and few instances")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.cpu_time:
        CLOCK = time.process_time
    spec = Spec.model_validate_json(options.spec.read_text())
    mesh = read_domain_mesh(options.domain, spec.units)
    domain = Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, spec.units or mesh.units))
    breakdown(domain, (100,))  # compiles
    result = {
        "domain": options.domain.name,
        "clock": "process" if options.cpu_time else "wall",
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "breakdown": breakdown(domain, (300, 800) if options.quick else tuple(PUBLISHED), say=True),
        "quality": quality(domain, (300,) if options.quick else (60, 300, 800)),
        "convergence": convergence(domain, options.out / "cut_convergence.png"),
        "scaling": scaling(domain, (300, 800) if options.quick else (300, 800, 2000, 5000)),
        "random_instances": random_instances(domain, 12 if options.quick else 100),
    }
    (options.out / "cut.json").write_text(json.dumps(result, indent=2) + "\n")
    print(f"\nWritten: {options.out / 'cut.json'}")


def breakdown(domain: Domain, counts: tuple[int, ...], say: bool = False) -> list[dict[str, float]]:
    """Seconds of each stage by number of sites, beside appendix A."""
    table = []
    for count in counts:
        flow, flow_s = timed(lambda: flow_field(domain, PotentialFlow()))
        graph, graph_s = timed(lambda n=count, f=flow: site_graph(domain, f, GraphSpec(sites=n), 0))
        problem = problem_of(graph)
        start, start_s = timed(lambda g=graph, p=problem: first_partition(g, p, 0))
        _, climb_s = timed(lambda p=problem, s=start: greedy(p, s))
        partition, cut_s = timed(lambda g=graph: max_cut(g, PartitionSpec(), 0))
        _, skeleton_s = timed(lambda g=graph, p=partition: skeletons(domain, g, p))
        table.append({
            "sites": count, "edges": len(graph.edges), "flow_s": flow_s, "graph_s": graph_s,
            "algorithm_1_s": start_s + climb_s, "anneal_and_bound_s": cut_s, "skeletons_s": skeleton_s,
            "total_s": flow_s + graph_s + cut_s + skeleton_s,
            "published_graph_s": PUBLISHED.get(count, (float("nan"),) * 2)[0],
            "published_cut_s": PUBLISHED.get(count, (float("nan"),) * 2)[1],
        })  # fmt: skip
    if say:
        print("\nSeconds (published: appendix A)\nsites  flow  graph  published   Algorithm 1  published   "
              "annealed+bound  skeletons  total")  # fmt: skip
        for r in table:
            print(f"{r['sites']:5d} {r['flow_s']:5.2f} {r['graph_s']:6.2f} {r['published_graph_s']:10.2f} "
                  f"{r['algorithm_1_s']:13.4f} {r['published_cut_s']:10.4f} {r['anneal_and_bound_s']:16.2f} "
                  f"{r['skeletons_s']:10.2f} {r['total_s']:6.2f}")  # fmt: skip
    return table


def quality(domain: Domain, counts: tuple[int, ...]) -> list[dict[str, float]]:
    """Cut weight of Algorithm 1 and of annealing at two budgets, and the gap to the proven bound."""
    print("\nCut over total weight, mean of 3 seeds\nsites   a  Algorithm 1 (ms)   0.025 s: gain (ms)     1 s: gain (s)"
          "   gap to the bound")  # fmt: skip
    table = []
    for count in counts:
        for transverse in (1.0, 5.0):
            rows = [_quality(domain, count, transverse, seed) for seed in range(3)]
            mean = {k: float(np.mean([r[k] for r in rows])) for k in rows[0]}
            table.append(mean)
            print(f"{count:5d} {transverse:3.0f} {mean['algorithm_1']:9.4f} {1e3 * mean['algorithm_1_s']:7.2f}   "
                  f"{mean['short_gain']:+10.2%} {1e3 * mean['short_s']:7.1f}  {mean['long_gain']:+10.2%} "
                  f"{mean['long_s']:6.2f} {mean['gap']:14.2%}")  # fmt: skip
    return table


def _quality(domain: Domain, count: int, transverse: float, seed: int) -> dict[str, float]:
    flow = flow_field(domain, PotentialFlow())
    graph = site_graph(domain, flow, GraphSpec(preset="paper", sites=count, transverse_weight=transverse), seed)
    problem, total = problem_of(graph), float(graph.weights.sum())
    start, start_s = timed(lambda: first_partition(graph, problem, seed))
    (climbed, _), climb_s = timed(lambda: greedy(problem, start))
    (short, _), short_s = timed(lambda: anneal(problem, start, int(0.025 * PROPOSALS_PER_SECOND), seed))
    (long, _), long_s = timed(lambda: anneal(problem, start, PROPOSALS_PER_SECOND, seed))
    base = cut_weight(graph, climbed)
    return {
        "sites": count, "transverse_weight": transverse, "algorithm_1": base / total,
        "algorithm_1_s": start_s + climb_s, "short_gain": cut_weight(graph, short) / base - 1, "short_s": short_s,
        "long_gain": cut_weight(graph, long) / base - 1, "long_s": long_s,
        "gap": 1 - cut_weight(graph, long) / upper_bound(graph),
    }  # fmt: skip


def convergence(domain: Domain, picture: Path) -> list[dict[str, object]]:
    """Algorithm 1's cut weight by iteration at the sizes of appendix B, and its plot."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    table: list[dict[str, object]] = []
    print("\nConvergence of Algorithm 1, weights 1 (appendix B: converges within as many iterations as sites)")
    print("sites  edges  iterations  first cut  last cut")
    for count in CONVERGENCE:
        graph = site_graph(domain, None, GraphSpec(preset="paper", sites=count), 0)
        history = max_cut(graph, PartitionSpec(method="greedy"), 0).history
        axes.plot(history[:, 0], history[:, 1], label=f"{count} sites")
        print(f"{count:5d} {len(graph.edges):6d} {len(history) - 1:11d} {history[0, 1]:10.0f} {history[-1, 1]:9.0f}")
        table.append({"sites": count, "edges": len(graph.edges), "history": history[:, 1].tolist()})
    axes.set(xlabel="iteration", ylabel="cut edges", title="Algorithm 1")
    axes.legend()
    figure.savefig(picture, dpi=150)
    pyplot.close(figure)
    return table


def scaling(domain: Domain, counts: tuple[int, ...]) -> dict[str, object]:
    """Seconds from domain to skeletons by size, with the fitted exponent, and the peak of memory."""
    table = breakdown(domain, counts)
    sizes, seconds = (np.array([r[k] for r in table]) for k in ("sites", "total_s"))
    exponent = float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("\nDomain to skeletons: " + ", ".join(f"{n} sites {s:.1f} s" for n, s in zip(sizes, seconds, strict=True)))
    print(f"fitted exponent {exponent:.2f}, peak memory {memory:.0f} MB")
    return {"table": table, "exponent": exponent, "peak_memory_mb": memory}


def random_instances(domain: Domain, count: int) -> dict[str, float]:
    """Annealing against Algorithm 1 on random instances: U-bend, cube, pipe; 50 to 2,000 sites; a = 1 and 5."""
    generator = np.random.default_rng(0)
    shapes = (domain, _body(trimesh.creation.box((1, 1, 1))), _body(trimesh.creation.cylinder(0.15, 1.0)))
    gains, broken = [], 0
    for k in range(count):
        sites = int(np.exp(generator.uniform(np.log(50), np.log(2000))))
        chosen = shapes[k % 3]
        flow = flow_field(chosen, PotentialFlow())
        graph: Graph = site_graph(
            chosen, flow, GraphSpec(preset="paper", sites=sites, transverse_weight=(1.0, 5.0)[k % 2]), k
        )
        problem = problem_of(graph)
        start = first_partition(graph, problem, k)
        best, _ = anneal(problem, start, PROPOSALS_PER_SECOND // 10, k)
        climbed, _ = greedy(problem, start)
        broken += bool(violations(graph, best))
        gains.append(cut_weight(graph, best) / cut_weight(graph, climbed) - 1)
    print(f"\n{count} random instances, 0.1 s each: annealing over Algorithm 1 {min(gains):+.2%} at worst, "
          f"{np.mean(gains):+.2%} on average, {broken} broken constraints")  # fmt: skip
    return {"count": count, "worst": min(gains), "mean": float(np.mean(gains)), "broken": broken}


def _body(mesh: trimesh.Trimesh) -> Domain:
    """A body with both fluids through its two ends across z."""
    vertices = (mesh.vertices - mesh.bounds[0]) * 0.1
    top = float(vertices[:, 2].max())
    low, high = ({"box": [[-1, -1, z], [1, 1, z]]} for z in (0.0, top))
    fluids = FluidsSpec.model_validate(
        {"hot": {"inlets": [low], "outlets": [high]}, "cold": {"inlets": [high], "outlets": [low]}}
    )
    body = DomainMesh(vertices, mesh.faces.astype(np.int64), Unit.M)
    return Domain.from_mesh(body, resolve_ports(body, fluids, Unit.M))


if __name__ == "__main__":
    main()
