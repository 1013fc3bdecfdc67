/** Figures of an evaluation in words. What the words mean is in docs/howto/web-pages.md. */

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
  /** What was looked at. */
  readonly about: string;
  readonly figure: string;
  readonly words: string;
};

/** Words from the best down; each holds up to its limit. */
type Scale = readonly (readonly [number, string])[];

const worse = Number.POSITIVE_INFINITY;
/** By the PSNR, negated so that less is better: a pixel is off by 3 %, 5 %, 8 %, 13 % of the range or more. */
const pictures: Scale = [
  [-30, "hard to tell from the photographs"],
  [-26, "very close to the photographs"],
  [-22, "close; fine detail and highlights differ"],
  [-18, "recognisable, but blurred or of another colour in places"],
  [worse, "far from the photographs; look at the findings of the capture and at the masks"],
];
const angles: Scale = [
  [5, "smooth and right to the eye"],
  [10, "right in the large, with small dents"],
  [20, "rough"],
  [worse, "wrong in large parts"],
];
const roughness: Scale = [
  [0.08, "highlights have the right size"],
  [0.16, "highlights are somewhat too sharp or too soft"],
  [worse, "gloss is not to be relied on"],
];

type Kind = {
  readonly about: string;
  readonly scale: Scale;
  /** Returns what the scale is about. */
  readonly measured: (value: number) => number;
  /** Says instead of "the photographs" what the figure compares with. */
  readonly truth?: string;
};

const negated = (value: number): number => -value;
const same = (value: number): number => value;
const novel: Kind = { about: "New views", scale: pictures, measured: negated };
const relit: Kind = { about: "New light", scale: pictures, measured: negated, truth: "the real pictures" };

const kinds: ReadonlyMap<string, Kind> = new Map([
  ["nvs/psnr", novel],
  ["nvs_several_lights/psnr", novel],
  ["training_views/psnr", { ...novel, about: "Views it was trained on" }],
  ["relight/psnr", relit],
  ["relight_one_light/psnr", relit],
  [
    "albedo_rgb_ratio/psnr_gamma",
    { about: "Colour of the material", scale: pictures, measured: negated, truth: "the true colour" },
  ],
  ["normal/mae_mask", { about: "Shape", scale: angles, measured: same }],
  ["roughness/rmse", { about: "Gloss", scale: roughness, measured: same }],
]);

/** Return what a report says of the result, in the order of importance. */
export function verdicts(report: Report): Verdict[] {
  const metrics = new Map((report.metrics ?? []).map((metric) => [metric.name, metric]));
  return [...kinds].flatMap(([name, kind]) => {
    const metric = metrics.get(name);
    if (metric === undefined || !Number.isFinite(metric.value)) return [];
    const measured = kind.measured(metric.value);
    const words = kind.scale.find(([limit]) => measured <= limit)![1];
    const told = kind.truth === undefined ? words : words.replace("the photographs", kind.truth);
    return [{ about: kind.about, figure: figureText(metric), words: told }];
  });
}

function figureText({ value, unit = "" }: Metric): string {
  if (unit === "deg") return `${value.toFixed(1)}° off`;
  if (unit === "dB") return `${value.toFixed(1)} dB`;
  return value.toFixed(2);
}

/** Return the rows of the table of figures: name, value with unit, standard error. */
export function metricRows(report: Report): [string, string, string][] {
  return (report.metrics ?? []).map(({ name, value, unit = "", standard_error: error = 0 }) => {
    const suffix = unit === "" || unit === "1" ? "" : ` ${unit}`;
    const digits = unit === "dB" || unit === "deg" ? 2 : 4;
    return [name, `${value.toFixed(digits)}${suffix}`, error > 0 ? `± ${error.toFixed(digits)}` : ""];
  });
}
