"""Reads a lake as its users do: with DuckDB and polars, without any word of ours but the files.

lake_readers.py LAKE FILES    one JSON object: what each reader finds in the lake, and in the files that count (a list, one a line)
lake_readers.py --evolve LAKE OLD
                              writes the lake's rows without the columns `operator` and `reason` to OLD, as a release before them would
                              have, and reads both together
lake_readers.py --s3          serves S3 (moto) at a free port of the loopback, says which, and ends when its input does
"""

import json
import sys
from pathlib import Path

WORDS = "count(*) AS rows, count(DISTINCT check_number) AS checks, sum(wear_um) AS wear_um, min(station) AS station, " \
    "CAST(max(date) AS VARCHAR) AS date, CAST(epoch_ms(max(stored_at)) AS BIGINT) AS at_ms"


def duckdb_finds(files):
    import duckdb

    found = duckdb.sql(f"SELECT {WORDS} FROM read_parquet({files!r}, hive_partitioning = true)")
    return dict(zip(found.columns, found.fetchall()[0]))


def polars_finds(files):
    import polars as pl

    frame = pl.scan_parquet(files, hive_partitioning=True)
    row = frame.select(
        pl.len().alias("rows"),
        pl.col("check_number").n_unique().alias("checks"),
        pl.col("wear_um").sum(),
        pl.col("station").min(),
        pl.col("date").max().cast(pl.String),
        pl.col("stored_at").max().dt.epoch("ms").alias("at_ms"),
    )
    return row.collect().row(0, named=True)


def read(lake, listing):
    files = Path(listing).read_text().split("\n")[:-1]
    glob = f"{lake}/*/*/*.parquet"
    return {
        "duckdb": duckdb_finds(files),
        "polars": polars_finds(files),
        "duckdb_glob": duckdb_finds(glob),
        "polars_glob": polars_finds(glob),
        "duckdb_rule": duckdb_rule(glob),
    }


def duckdb_rule(glob):
    """The rule of the lake in SQL, as docs/formats/lake.md has it."""
    import duckdb

    page = Path(__file__).parents[2] / "docs/formats/lake.md"
    sql = page.read_text().split("```sql\n")[1].split("```")[0]
    connection = duckdb.connect()
    connection.execute(sql.replace("LAKE/*/*/*.parquet", glob))
    found = connection.sql(f"SELECT {WORDS} FROM checks")
    return dict(zip(found.columns, found.fetchall()[0]))


def evolve(lake, old):
    import duckdb
    import polars as pl

    glob = f"{lake}/*/*/*.parquet"
    Path(old).mkdir(parents=True)
    duckdb.sql(
        f"COPY (SELECT * EXCLUDE (operator, reason, station, date) FROM read_parquet('{glob}')) TO '{old}/old.parquet'"
    )
    both = [glob, f"{old}/old.parquet"]
    sql = f"SELECT count(*), count(operator), count(reason) FROM read_parquet({both!r}, union_by_name = true)"
    frame = pl.scan_parquet(both, missing_columns="insert", hive_partitioning=False)
    row = frame.select(pl.len(), pl.col("operator").count(), pl.col("reason").count().alias("r")).collect()
    return {"duckdb": list(duckdb.sql(sql).fetchall()[0]), "polars": list(row.row(0))}


def serve():
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    print(f"http://{host}:{port}", flush=True)
    sys.stdin.read()
    server.stop()


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--s3"]:
            serve()
        case ["--evolve", lake, old]:
            print(json.dumps(evolve(lake, old)))
        case [lake, listing]:
            print(json.dumps(read(lake, listing)))
        case _:
            sys.exit(__doc__)
