"""Answers the named questions with DuckDB, by the same SQL.

questions_in_duckdb.py FILES QUESTIONS OUT    FILES: the files that count, one a line; QUESTIONS: the SQL; OUT: folder for NAME.json
"""

import sys
from pathlib import Path

import duckdb

listing, questions, out = map(Path, sys.argv[1:])
files = listing.read_text().split("\n")[:-1]
views, *named = questions.read_text().split("-- name: ")
connection = duckdb.connect()
connection.execute("SET TimeZone = 'UTC'")
types = "hive_partitioning = true, hive_types = {'station': VARCHAR, 'date': DATE}, union_by_name = true"
connection.execute(f"CREATE VIEW checks AS SELECT * FROM read_parquet({files!r}, {types})")
connection.execute(views)
for question in named:
    name, sql = question.split("\n", 1)
    connection.execute(f"COPY ({sql.rstrip().rstrip(';')}) TO '{out / name}.json' (FORMAT json, ARRAY true)")
