"""The trend of each flank of the tool that was checked last, from a table of `flankscope history FILE --csv TABLE`: `history_table.py TABLE`.

A straight line through the wear of each flank over the tool's cycles, weighted by its uncertainty, in the tool's present life and with
its present baseline. `flankscope history` itself gives the cycles that are left, with their uncertainty.
"""

import sys

import numpy as np
import pandas as pd


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """Wear by the line at the last check, and its rate with standard uncertainties; a row per flank with three measured checks."""
    checks = table.drop_duplicates("check").sort_values("check")
    last = checks.iloc[-1]
    checks = checks[checks["tool"] == last["tool"]]
    # Where the cycles decrease, a new life of the tool begins.
    lives = (checks["tool_cycles"].diff() < 0).cumsum()
    same_baseline = checks["baseline"].isna() if pd.isna(last["baseline"]) else checks["baseline"] == last["baseline"]
    checks = checks[(lives == lives.iloc[-1]) & same_baseline]
    table = table[table["check"].isin(checks["check"])]
    rows = []
    for (tooth, flank), of in table.dropna(subset=["wear_um", "u95_um"]).groupby(["tooth", "flank"]):
        if of["tool_cycles"].nunique() < 3:
            continue
        sigma_um = (of["u95_um"] / 1.96).to_numpy()
        cycles = (of["tool_cycles"] - last["tool_cycles"]).to_numpy(np.float64)
        line, covariance = np.polyfit(cycles, of["wear_um"].to_numpy(), 1, w=1 / sigma_um, cov="unscaled")
        u = np.sqrt(np.diag(covariance))
        rows.append((tooth, flank, len(of), line[1], u[1], line[0], u[0], of["limit_um"].iloc[-1]))
    columns = ["tooth", "flank", "checks", "wear_um", "u_um", "um_per_cycle", "u_um_per_cycle", "limit_um"]
    return pd.DataFrame(rows, columns=columns).sort_values("um_per_cycle", ascending=False, ignore_index=True)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(trends(pd.read_csv(sys.argv[1])).to_string(index=False, float_format="{:.4g}".format))
