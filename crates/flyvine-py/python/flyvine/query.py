"""SQL over the tables of sweeps, by DuckDB: ``python -m flyvine.query RUN… 'SELECT … FROM rows'``.

RUNs are sweep folders, Parquet files or patterns of them; together they are the table ``rows``. Columns that only some of
them have are NULL in the others, and ``filename`` says where a row is from.
"""

import argparse
import glob
import os
import sys


def tables(runs: list[str]) -> list[str]:
    """The Parquet files of runs: folders, files or patterns."""
    found = []
    for run in runs:
        paths = sorted(glob.glob(run)) or [run]
        for path in paths:
            table = os.path.join(path, "results.parquet") if os.path.isdir(path) else path
            if not os.path.isfile(table):
                raise FileNotFoundError(f"{table}: no such table; `flyvine sweep` or `flyvine merge` writes it")
            found.append(table)
    return found


def query(runs: list[str], sql: str):
    """The relation that a query makes of the tables of runs: ``.df()``, ``.pl()``, ``.arrow()``, ``.fetchall()``."""
    import duckdb

    connection = duckdb.connect()
    rows = connection.read_parquet(tables(runs), union_by_name=True, filename=True)
    connection.register("rows", rows)
    return connection.sql(sql)


def main() -> int:
    """The command."""
    import duckdb

    parser = argparse.ArgumentParser(prog="python -m flyvine.query", description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("sql", metavar="SQL")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="print CSV")
    form.add_argument("--json", action="store_true", help="print JSON, one object per row")
    arguments = parser.parse_args()
    try:
        relation = query(arguments.runs, arguments.sql)
        if relation is None:
            raise ValueError("found a statement without a result, expected a query")
        if arguments.csv:
            import csv

            writer = csv.writer(sys.stdout)
            writer.writerow(relation.columns)
            writer.writerows(relation.fetchall())
        elif arguments.json:
            import json

            for row in relation.fetchall():
                print(json.dumps(dict(zip(relation.columns, row)), default=str))
        else:
            relation.show(max_rows=1000)
    except (OSError, ValueError, duckdb.Error) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
