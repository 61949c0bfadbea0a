-- What the view `days` of questions.sql means, straight from rows: a die's life is told over all its checks at once, without runs and sums.
WITH readings AS (
    SELECT *, CAST(tool_cycles - first_cycles AS DOUBLE) AS x,
        CASE WHEN abs(wear_um) < 1e9 AND u95_um < 1e9 AND (verdict <> 'indeterminate' OR code = 'undecidable') THEN wear_um END AS w,
        CAST(sum(CASE WHEN tool_cycles < before THEN 1 ELSE 0 END) OVER
            (PARTITION BY simulated, tool, serial, place ORDER BY stored_at, check_number, history) AS BIGINT) AS life
    FROM (
        SELECT simulated, station, date, stored_at, check_number, history, tool, serial, place, tool_cycles, baseline, head_blake3, flank, patch,
            CASE WHEN patch IS NULL THEN tooth END AS tooth, wear_um, u95_um, warn_um, limit_um, verdict, code,
            lag(tool_cycles) OVER die AS before, first_value(tool_cycles) OVER die AS first_cycles
        FROM (SELECT *, CASE WHEN serial IS NULL THEN station END AS place FROM checks)
        WINDOW die AS (PARTITION BY simulated, tool, serial, place ORDER BY stored_at, check_number, history)
    )
)
SELECT simulated, station, tool, serial, place, life, baseline, head_blake3, tooth, flank, patch, date,
    count(w) AS n, sum(x) FILTER (WHERE w IS NOT NULL) AS sx, sum(w) AS sw,
    sum(x * x) FILTER (WHERE w IS NOT NULL) AS sxx, sum(x * w) AS sxw, sum(w * w) AS sww,
    min(x) FILTER (WHERE w IS NOT NULL) AS first_x, max(x) FILTER (WHERE w IS NOT NULL) AS last_x,
    min(stored_at) AS first_at, max(stored_at) AS last_at, min(tool_cycles) AS first_cycles,
    last(u95_um ORDER BY stored_at, check_number) FILTER (WHERE w IS NOT NULL) AS u95_um,
    sum(u95_um) FILTER (WHERE w IS NOT NULL) AS su95,
    last(warn_um ORDER BY stored_at, check_number) AS warn_um, last(limit_um ORDER BY stored_at, check_number) AS limit_um
FROM readings
GROUP BY simulated, station, tool, serial, place, life, baseline, head_blake3, tooth, flank, patch, date
