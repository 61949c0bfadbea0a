-- Questions to a lake, in SQL that DataFusion and DuckDB both take. The table `checks` has a row per check and flank, from the files that
-- count (docs/formats/lake.md). First come views, then the questions: a name, one sentence, one SELECT. Strokes are `tool_cycles`.
--
-- Every line is fitted by least squares. `u_…` is a standard uncertainty, `expanded_…` an expanded one (k = 2). What a line says of its own
-- scatter does not know of errors that all values share; these are in the values' own `u95_um`.

-- The rows of the last check of each history. Names of files tell where it is, so the program reads no other files for it.
CREATE VIEW last_checks AS
-- The few stand first: of them the engine makes its table.
SELECT c.* FROM (
    SELECT station AS its_station, history AS its_history, epoch AS its_epoch, max(check_number) AS its_last
    FROM checks GROUP BY station, history, epoch
) JOIN checks AS c ON station = its_station AND history = its_history AND epoch = its_epoch AND check_number = its_last;

-- Each row with the run of its die that it belongs to: the checks of one day between which strokes did not decrease, at whatever stations.
-- A die is a tool and its serial number; without a serial number it is known at its station only (`place`). Wear is empty unless it counts
-- for a trend, as at the station: an indeterminate value counts only if it is merely too near to a limit to be decided. `x` is the strokes
-- since the die's first check of the day.
CREATE VIEW readings AS
SELECT *, CAST(tool_cycles - base_cycles AS DOUBLE) AS x,
    CASE WHEN abs(wear_um) < 1e9 AND u95_um < 1e9 AND (verdict <> 'indeterminate' OR code = 'undecidable') THEN wear_um END AS w,
    CAST(sum(CASE WHEN tool_cycles < before THEN 1 ELSE 0 END) OVER
        (PARTITION BY date, simulated, tool, serial, place ORDER BY stored_at, check_number, history) AS BIGINT) AS run
FROM (
    SELECT simulated, station, date, stored_at, check_number, history, tool, serial, place, tool_cycles, baseline, head_blake3, flank, patch,
        -- The number of a patch changes when others are added; its name does not.
        CASE WHEN patch IS NULL THEN tooth END AS tooth,
        wear_um, u95_um, warn_um, limit_um, verdict, code,
        lag(tool_cycles) OVER die AS before, first_value(tool_cycles) OVER die AS base_cycles
    FROM (SELECT *, CASE WHEN serial IS NULL THEN station END AS place FROM checks)
    WINDOW die AS (PARTITION BY date, simulated, tool, serial, place ORDER BY stored_at, check_number, history)
);

-- Sums of a flank and run under the same conditions. They need nothing of other days, so `flankscope-fleet compact` keeps them in a file
-- for every day that is over, and `query` takes what this SELECT says from there.
CREATE VIEW sums AS
SELECT date, simulated, tool, serial, place, run, station, baseline, head_blake3, tooth, flank, patch,
    min(base_cycles) AS base_cycles, min(tool_cycles) AS first_cycles, max(tool_cycles) AS last_cycles,
    min(stored_at) AS first_at, max(stored_at) AS last_at,
    count(w) AS n, sum(x) FILTER (WHERE w IS NOT NULL) AS sx, sum(w) AS sw,
    sum(x * x) FILTER (WHERE w IS NOT NULL) AS sxx, sum(x * w) AS sxw, sum(w * w) AS sww,
    min(x) FILTER (WHERE w IS NOT NULL) AS first_x, max(x) FILTER (WHERE w IS NOT NULL) AS last_x,
    last(u95_um ORDER BY stored_at, check_number) FILTER (WHERE w IS NOT NULL) AS u95_um,
    sum(u95_um) FILTER (WHERE w IS NOT NULL) AS su95,
    last(warn_um ORDER BY stored_at, check_number) AS warn_um, last(limit_um ORDER BY stored_at, check_number) AS limit_um
FROM readings
GROUP BY date, simulated, tool, serial, place, run, station, baseline, head_blake3, tooth, flank, patch;

-- The same with the life of the die: a new one begins where the strokes decrease, within a day or from one to the next, so a day has no
-- two runs of one life. `x` is now the strokes since the die's first check in the lake. Sums of days add up to those of longer times.
CREATE VIEW days AS
SELECT simulated, station, tool, serial, place, life, baseline, head_blake3, tooth, flank, patch, date,
    n, sx + n * d AS sx, sw, sxx + 2 * d * sx + n * d * d AS sxx, sxw + d * sw AS sxw, sww, first_x + d AS first_x, last_x + d AS last_x,
    first_at, last_at, first_cycles, u95_um, su95, warn_um, limit_um
FROM (
    SELECT *, CAST(base_cycles - first_value(base_cycles) OVER die AS DOUBLE) AS d,
        CAST(sum(CASE WHEN begins_run AND run_first < before THEN 1 ELSE 0 END) OVER die AS BIGINT) AS life
    FROM (
        SELECT *, lag(run_last) OVER die AS before, (lag(date) OVER die IS DISTINCT FROM date) OR (lag(run) OVER die <> run) AS begins_run
        FROM (
            SELECT *, min(first_cycles) OVER one AS run_first, max(last_cycles) OVER one AS run_last
            FROM sums
            WINDOW one AS (PARTITION BY simulated, tool, serial, place, date, run)
        )
        WINDOW die AS (PARTITION BY simulated, tool, serial, place ORDER BY date, run)
    )
    WINDOW die AS (PARTITION BY simulated, tool, serial, place ORDER BY date, run)
);

-- The line of each flank at one station in one life of its die, with one baseline and one head. A line needs five values, as at the
-- station; `slope` is empty without. `off_um` is how far the mean of the last day lies from it.
CREATE VIEW lines AS
SELECT *, (last_sw - last_n * mean_w - slope * (last_sx - last_n * mean_x)) / last_n AS off_um,
    sqrt(greatest(s2 * (1.0 / last_n - 1.0 / n - (last_sx / last_n - mean_x) * (last_sx / last_n - mean_x) / cxx), 0.0)) AS u_off_um,
    mean_w + slope * (last_x - mean_x) AS now_um, sqrt(s2 / cxx) AS u_slope
FROM (
    SELECT *, sx / n AS mean_x, sw / n AS mean_w, sxx - sx * sx / n AS cxx,
        CASE WHEN n >= 5 AND last_x > first_x THEN (sxw - sx * sw / n) / (sxx - sx * sx / n) END AS slope,
        -- No scatter is smaller than a nanometre, the resolution of the stored values.
        CASE WHEN n >= 5 AND last_x > first_x THEN greatest(1e-6,
            (sww - sw * sw / n - (sxw - sx * sw / n) * (sxw - sx * sw / n) / (sxx - sx * sx / n)) / (n - 2)) END AS s2
    FROM (
        SELECT simulated, station, tool, serial, place, life, baseline, head_blake3, tooth, flank, patch,
            CAST(sum(n) AS DOUBLE) AS n, sum(sx) AS sx, sum(sw) AS sw, sum(sxx) AS sxx, sum(sxw) AS sxw, sum(sww) AS sww,
            min(first_x) AS first_x, max(last_x) AS last_x, min(first_at) AS first_at, max(last_at) AS last_at,
            min(first_cycles) AS first_cycles, last(u95_um ORDER BY date) FILTER (WHERE n > 0) AS u95_um,
            last(warn_um ORDER BY date) AS warn_um, last(limit_um ORDER BY date) AS limit_um,
            last(CAST(n AS DOUBLE) ORDER BY date) FILTER (WHERE n > 0) AS last_n, last(sx ORDER BY date) FILTER (WHERE n > 0) AS last_sx,
            last(sw ORDER BY date) FILTER (WHERE n > 0) AS last_sw
        FROM days
        GROUP BY simulated, station, tool, serial, place, life, baseline, head_blake3, tooth, flank, patch
    )
);

-- The lines under the conditions of each die's last check, and why one says nothing of the future. As at the station, a shift of less
-- than a twentieth of the warning limit changes no decision.
CREATE VIEW present AS
SELECT *, CASE
        WHEN slope IS NULL THEN 'fewer than five values'
        WHEN abs(off_um) > 3 * u_off_um AND abs(off_um) > warn_um / 20 THEN 'the last day left the line'
        WHEN slope <= 2 * u_slope THEN 'no wear beyond its uncertainty'
    END AS why_not
FROM (
    SELECT *, max(last_at) OVER (PARTITION BY simulated, tool, serial, place) AS die_at,
        max(last_at) OVER (PARTITION BY simulated, tool, serial, place, station, life, baseline, head_blake3) AS together_at
    FROM lines
)
WHERE together_at = die_at AND flank IS NOT NULL;

-- name: presses
-- The last check of every station, with the flank that is nearest to its limit. Within a history numbers tell which check is the last, because a clock may have been set back.
SELECT station, link, simulated, history, epoch, check_number, date, stored_at, tool, serial, tool_cycles, check_verdict, reason,
    tooth, flank, patch, wear_um, u95_um, limit_um
FROM (
    SELECT *, row_number() OVER (PARTITION BY station
        -- A recording is not the state of the press.
        ORDER BY link IN ('recorded frames', 'recorded clouds'), stored_at DESC, check_number DESC, limit_um - wear_um NULLS LAST, tooth, flank, patch) AS place_in_station
    FROM last_checks
)
WHERE place_in_station = 1
ORDER BY station;

-- name: dies-by-strokes-left
-- Each die's flank that reaches its limit first: strokes left on its line, and at least how many with 95 % probability; none, and why, where the line cannot tell.
SELECT station, tool, serial, tooth, flank, patch, simulated, die_at AS last_check, now_um, limit_um,
    1000 * slope AS um_per_1000_strokes, left_strokes AS strokes_left, at_least, why_not, off_line AS flanks_off_line
FROM (
    SELECT *, row_number() OVER (PARTITION BY simulated, tool, serial, place
        ORDER BY at_least NULLS LAST, left_strokes NULLS LAST, d NULLS LAST, tooth, flank, patch) AS place_in_die,
        count(CASE WHEN why_not = 'the last day left the line' THEN 1 END) OVER (PARTITION BY simulated, tool, serial, place) AS off_line
    FROM (
        SELECT *, CASE WHEN why_not IS NULL THEN greatest(d / slope, 0.0) END AS left_strokes,
            -- The strokes x at which slope * x + z * sqrt(u_d^2 + (u_slope * x)^2) reaches the distance d; z is 1.645: one side, 95 %.
            CASE WHEN why_not IS NULL THEN CASE WHEN d <= z * u_d THEN 0.0
                ELSE (d * slope - z * sqrt(slope * slope * u_d * u_d + u_slope * u_slope * (d * d - z * z * u_d * u_d)))
                    / (slope * slope - z * z * u_slope * u_slope) END END AS at_least
        FROM (SELECT *, limit_um - now_um AS d, u95_um / 1.959963984540054 AS u_d, 1.6448536269514722 AS z FROM present)
    )
)
WHERE place_in_die = 1
ORDER BY at_least NULLS LAST, tool, serial, station;

-- name: wear-per-thousand-strokes
-- Wear per thousand strokes of every flank now, beside the mean of the same flank of the other dies of its tool; `faster` beyond both uncertainties.
SELECT *, um_per_1000 - others_um_per_1000 > sqrt(expanded_um_per_1000 * expanded_um_per_1000 + expanded_others * expanded_others) AS faster
FROM (
    SELECT station, tool, serial, tooth, flank, patch, simulated, CAST(n AS BIGINT) AS points, 1000 * slope AS um_per_1000, 2000 * u_slope AS expanded_um_per_1000,
        dies - 1 AS other_dies, 1000 * (all_slope - slope) / nullif(dies - 1, 0) AS others_um_per_1000,
        2000 * sqrt(greatest(all_u2 - u_slope * u_slope, 0.0)) / nullif(dies - 1, 0) AS expanded_others
    FROM (
        SELECT *, count(*) OVER tools AS dies, sum(slope) OVER tools AS all_slope, sum(u_slope * u_slope) OVER tools AS all_u2
        FROM present WHERE slope IS NOT NULL
        WINDOW tools AS (PARTITION BY simulated, tool, tooth, flank, patch)
    )
)
ORDER BY um_per_1000 DESC, tool, serial, station, tooth, flank, patch;

-- name: stations-unlike-the-others
-- Ring comparison: how far each station measures from the others on the same flank of the same die in one life, on one common slope; `beyond_expanded` where that is more than its uncertainty, `beyond_u95` where it is more than the values' own.
SELECT station, simulated, dies, flanks, difference_um, expanded_um, u95_um,
    abs(difference_um) > expanded_um AS beyond_expanded, abs(difference_um) > u95_um AS beyond_u95
FROM (
    SELECT station, simulated, count(*) AS flanks, count(DISTINCT tool || ' / ' || serial) AS dies, sum(d / u2) / sum(1 / u2) AS difference_um,
        -- The flanks' own scatter counts where it is larger than what their values say.
        2 * sqrt(greatest(1 / sum(1 / u2),
            CASE WHEN count(*) > 1 THEN (sum(d * d / u2) - sum(d / u2) * sum(d / u2) / sum(1 / u2)) / (sum(1 / u2) * (count(*) - 1)) ELSE 0.0 END)) AS expanded_um,
        avg(u95) AS u95_um
    FROM (
        -- One station against all others, on the common line.
        SELECT *, (w - (all_w - n * w) / others) - slope * (x - (all_x - n * x) / others) AS d,
            s2 * (1 / n + 1 / others) + s2 / all_cxx * (x - (all_x - n * x) / others) * (x - (all_x - n * x) / others) AS u2,
            sqrt(own_u95 * own_u95 + ((all_u95 - n * own_u95) / others) * ((all_u95 - n * own_u95) / others)) AS u95
        FROM (
            SELECT *, all_n - n AS others, all_cxw / all_cxx AS slope,
                greatest(1e-6, (all_cww - all_cxw * all_cxw / all_cxx) / (all_n - stations - 1)) AS s2
            FROM (
                SELECT *, count(*) OVER ring AS stations, sum(n) OVER ring AS all_n, sum(n * x) OVER ring AS all_x, sum(n * w) OVER ring AS all_w,
                    sum(cxx) OVER ring AS all_cxx, sum(cxw) OVER ring AS all_cxw, sum(cww) OVER ring AS all_cww,
                    sum(n * own_u95) OVER ring AS all_u95, max(last_x - first_x) OVER ring AS longest
                FROM (
                    SELECT station, simulated, tool, serial, life, baseline, tooth, flank, patch, n, sx / n AS x, sw / n AS w, own_u95 / n AS own_u95,
                        first_x, last_x, sxx - sx * sx / n AS cxx, sxw - sx * sw / n AS cxw, sww - sw * sw / n AS cww
                    FROM (
                        SELECT station, simulated, tool, serial, life, baseline, tooth, flank, patch, CAST(sum(n) AS DOUBLE) AS n, sum(sx) AS sx,
                            sum(sw) AS sw, sum(sxx) AS sxx, sum(sxw) AS sxw, sum(sww) AS sww, sum(su95) AS own_u95,
                            min(first_x) AS first_x, max(last_x) AS last_x
                        FROM days WHERE serial IS NOT NULL AND n > 0
                        GROUP BY station, simulated, tool, serial, life, baseline, tooth, flank, patch
                    )
                )
                WINDOW ring AS (PARTITION BY simulated, tool, serial, life, baseline, tooth, flank, patch)
            )
            WHERE stations > 1 AND longest > 0 AND all_n - stations >= 5
        )
    )
    GROUP BY station, simulated
)
ORDER BY abs(difference_um) / expanded_um DESC, station;

-- name: changes
-- What a station's next die, life, baseline or head changed: wear per thousand strokes before and after, with the uncertainty of the difference; within one life also the step in wear where they meet.
SELECT *, abs(change_um_per_1000) > expanded_change AS other_rate, abs(step_um) > expanded_step AS other_level
FROM (
    SELECT station, simulated, tool, serial, tooth, flank, patch, first_at AS since,
        CASE WHEN (serial IS DISTINCT FROM old_serial) THEN 'die' WHEN life <> old_life THEN 'life'
            WHEN (baseline IS DISTINCT FROM old_baseline) THEN 'baseline' ELSE 'head' END AS changed,
        1000 * old_slope AS before_um_per_1000, 2000 * old_u_slope AS expanded_before, 1000 * slope AS after_um_per_1000, 2000 * u_slope AS expanded_after,
        1000 * (slope - old_slope) AS change_um_per_1000, 2000 * sqrt(u_slope * u_slope + old_u_slope * old_u_slope) AS expanded_change,
        CASE WHEN (serial IS NOT DISTINCT FROM old_serial) AND life = old_life
            THEN mean_w - old_mean_w + slope * (first_x - mean_x) - old_slope * (first_x - old_mean_x) END AS step_um,
        CASE WHEN (serial IS NOT DISTINCT FROM old_serial) AND life = old_life
            THEN 2 * sqrt(s2 / n + old_s2 / old_n + u_slope * u_slope * (first_x - mean_x) * (first_x - mean_x)
                + old_u_slope * old_u_slope * (first_x - old_mean_x) * (first_x - old_mean_x)) END AS expanded_step
    FROM (
        SELECT *, lag(serial) OVER by_time AS old_serial, lag(life) OVER by_time AS old_life, lag(baseline) OVER by_time AS old_baseline,
            lag(slope) OVER by_time AS old_slope, lag(u_slope) OVER by_time AS old_u_slope, lag(mean_w) OVER by_time AS old_mean_w,
            lag(mean_x) OVER by_time AS old_mean_x, lag(s2) OVER by_time AS old_s2, lag(n) OVER by_time AS old_n
        FROM lines WHERE slope IS NOT NULL
        WINDOW by_time AS (PARTITION BY simulated, station, tool, tooth, flank, patch ORDER BY first_at, serial, life)
    )
    WHERE old_slope IS NOT NULL
)
ORDER BY since DESC, station, tool, serial, tooth, flank, patch;
