"""The table of a study over generated scenes, as text."""

from __future__ import annotations

from collections import Counter

from estimation.statistics import median, share


def text(results: list[dict]) -> str:
    """Shares and medians with their 95 % intervals, and the causes of the failures."""
    done = [r for r in results if "error" not in r]
    passed = [r for r in results if not r["failures"]]
    deep = [r for r in done if r["depth"] > 1]
    lines = [
        f"| of {len(results)} scenes | |", "|---|---|",
        f"| pass all criteria | {_share(len(passed), len(results))} |",
        f"| no result | {_share(len(results) - len(done), len(results))} |",
    ]  # fmt: skip
    for name in ("track", "NEES", "landmarks", "false landmarks"):
        lines.append(
            f"| within the limit: {name} | {_share(sum(name not in r['failures'] for r in done), len(done))} |"
        )
    for title, some in (("", done), (", two reflections traced", deep)):
        if some:
            ratio, nees = median([r["rmse_over_bound"]["position"] for r in some]), median([r["nees"] for r in some])
            lines.append(f"| median RMSE/PEB, median NEES{title} | {_value(ratio)}, {_value(nees)} |")
    total = Counter()
    for r in done:
        total.update({k: v for k, v in r.items() if isinstance(v, int) and ("landmarks" in k or "second" in k)})
    lines += [
        "| landmarks visible / mapped at some step / in the final map; false | "
        f"{total['landmarks_visible']} / {total['landmarks_ever']} / {total['landmarks_found']}; "
        f"{total['false_landmarks']} |",
        f"| second reflections in the final map | {total['second_reflections_found']} of "
        f"{total['second_reflections_visible']} |",
    ]
    kinds = Counter(r["kind"] for r in results)
    good = Counter(r["kind"] for r in passed)
    lines.append("| pass by kind | " + ", ".join(f"{kind} {good[kind]} of {n}" for kind, n in kinds.items()) + " |")
    causes = Counter(r["cause"].partition(" (")[0] for r in results if r["failures"])
    lines += ["", "First cause of the failures:", *(f"{n:4}  {cause}" for cause, n in causes.most_common())]
    return "\n".join(lines) + "\n"


def _share(part: int, whole: int) -> str:
    value = share(part, whole)
    return f"{part} of {whole} ({value['low']:.0%}–{value['high']:.0%})"


def _value(of: dict) -> str:
    return f"{of['value']:.2f} ({of['low']:.2f}–{of['high']:.2f})"
