/** Figures of an evaluation in words, which docs/howto/web-pages.md explains. */

import { formatNumber } from "../page/format.js";
import { fillIn, texts } from "../words/words.js";

/** The part of report.json (lambent_proto.v1.EvaluationReport) that is shown. */
export type Report = {
  readonly metrics?: readonly Metric[];
  readonly num_views?: number;
  readonly notes?: readonly string[];
};

type Metric = {
  readonly name: string;
  readonly value: number;
  readonly unit?: string;
  readonly standard_error?: number;
};

export type Verdict = {
  /** What was evaluated. */
  readonly about: string;
  readonly figure: string;
  readonly words: string;
};

/** Words from the best down, each with the largest value that it describes. */
type Scale<Name extends string> = readonly (readonly [number, Name])[];

const worse = Number.POSITIVE_INFINITY;
/** By the PSNR, negated so that less is better: a pixel is off by 3 %, 5 %, 8 %, 13 % of the range or more. */
const pictures: Scale<keyof (typeof texts)["verdicts"]["pictures"]> = [
  [-30, "best"],
  [-26, "good"],
  [-22, "fair"],
  [-18, "poor"],
  [worse, "bad"],
];
const angles: Scale<keyof (typeof texts)["verdicts"]["angles"]> = [
  [5, "best"],
  [10, "good"],
  [20, "fair"],
  [worse, "bad"],
];
const roughness: Scale<keyof (typeof texts)["verdicts"]["roughness"]> = [
  [0.08, "best"],
  [0.16, "good"],
  [worse, "bad"],
];

function on<Name extends string>(scale: Scale<Name>, value: number): Name {
  return scale.find(([limit]) => value <= limit)![1];
}

type Kind = {
  readonly about: string;
  readonly words: (value: number) => string;
};

/** Return the figures of a report that are put in words, the most important first. */
function kinds(): ReadonlyMap<string, Kind> {
  const likeness = (about: string, truth: string): Kind => ({
    about,
    words: (psnr) => fillIn(texts.verdicts.pictures[on(pictures, -psnr)], { truth }),
  });
  return new Map([
    ["nvs/psnr", likeness(texts.verdicts.newViews, texts.verdicts.photographs)],
    ["nvs_several_lights/psnr", likeness(texts.verdicts.newViews, texts.verdicts.photographs)],
    ["training_views/psnr", likeness(texts.verdicts.trainedViews, texts.verdicts.photographs)],
    ["relight/psnr", likeness(texts.verdicts.newLight, texts.verdicts.realPictures)],
    ["relight_one_light/psnr", likeness(texts.verdicts.newLight, texts.verdicts.realPictures)],
    ["albedo_rgb_ratio/psnr_gamma", likeness(texts.verdicts.colour, texts.verdicts.trueColour)],
    [
      "normal/mae_mask",
      { about: texts.verdicts.shape, words: (value) => texts.verdicts.angles[on(angles, value)] },
    ],
    [
      "roughness/rmse",
      { about: texts.verdicts.gloss, words: (value) => texts.verdicts.roughness[on(roughness, value)] },
    ],
  ]);
}

/** Return a report's verdicts on the result, the most important first. */
export function verdicts(report: Report): Verdict[] {
  const metrics = new Map((report.metrics ?? []).map((metric) => [metric.name, metric]));
  return [...kinds()].flatMap(([name, kind]) => {
    const metric = metrics.get(name);
    if (metric === undefined || !Number.isFinite(metric.value)) return [];
    return [{ about: kind.about, figure: figureText(metric), words: kind.words(metric.value) }];
  });
}

function figureText({ value, unit = "" }: Metric): string {
  if (unit === "deg") return fillIn(texts.verdicts.off, { degrees: formatNumber(value, 1) });
  if (unit === "dB") return `${formatNumber(value, 1)} dB`;
  return formatNumber(value, 2);
}

/** Return the rows of the table of figures: name, value with unit, standard error. */
export function metricRows(report: Report): [string, string, string][] {
  return (report.metrics ?? []).map(({ name, value, unit = "", standard_error: error = 0 }) => {
    const suffix = unit === "" || unit === "1" ? "" : ` ${unit}`;
    const digits = unit === "dB" || unit === "deg" ? 2 : 4;
    return [
      name,
      `${formatNumber(value, digits)}${suffix}`,
      error > 0 ? `± ${formatNumber(error, digits)}` : "",
    ];
  });
}
