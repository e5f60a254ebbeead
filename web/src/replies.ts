// The types on the wire. Written by scripts/wire_types.py from the questions of the app; do not edit.

/** A value of a project file. */
export type Toml = string | number | boolean | Toml[] | { [key: string]: Toml };

/** A key of a project file; entries of a list count from 1. */
export type Path = (string | number)[];

/** JSON or arrays of a reply that has none. */
export type Nothing = Record<string, never>;

/** A parameter by its name. */
export interface AskedTable {
  name: string;
}

/** The parameter that was asked for. */
export interface TableReply {
  table: EditedTable;
}

/** A parameter as the editor shows it; lists are in C order: `values[i * ny + j]` is at x[i], y[j]. */
export interface EditedTable {
  name: string;
  kind: string;
  unit: string;
  description: string;
  axes: AxisPoints[];
  values: number[];
  /** Values to compare with. */
  reference: number[];
  /** Where these are from. */
  referenceTitle: string;
  /** Numbers of values that are not fitted. */
  locked: number[];
  /** Numbers of values that a pin holds. */
  pinned: number[];
  /** Numbers of values whose edits wait for the end of a run. */
  waiting: number[];
  lower: (number | null)[];
  upper: (number | null)[];
  /** Number of samples that inform each value; null if it is not known. */
  samples: number[] | null;
  /** Standard deviation of each value; null if it is not known. */
  deviation: (number | null)[] | null;
}

/** An axis of a table: its input, unit and breakpoints. */
export interface AxisPoints {
  input: string;
  unit: string;
  points: number[];
}

/** Signals over a stretch of a dataset; `only` limits the samples, `brush` lights some of them. */
export interface AskedStrip {
  dataset: number;
  signals: SignalName[];
  begin: number;
  end: number;
  pixels: number;
  only?: SampleSelection | null;
  brush?: SampleSelection | null;
}

/** The quantity that a line shows. */
export interface SignalName {
  /**
   * A channel; the target of a criterion, NaN where it is not scored; a node at the present values or at those of the
   * start; the error of a criterion at the present values or at those of the start.
   */
  kind: "channel" | "target" | "node" | "start" | "error" | "start error";
  /** Of the channel or node; the number of the criterion for targets and errors. */
  name: string;
  /** Of a channel that the project does not use; for the page alone, and not compared. */
  unit?: string;
}

/**
 * Samples of a dataset: those between two positions at which every signal is within its range. With `point`, only those
 * whose lookup gives this value of a table a weight.
 */
export interface SampleSelection {
  ranges?: SignalRange[];
  begin?: number;
  end?: number;
  point?: GridPoint | null;
}

/** Values of a signal, with both ends. */
export interface SignalRange {
  signal: SignalName;
  least: number;
  greatest: number;
}

/** A value of a table, by its number in C order. */
export interface GridPoint {
  parameter: string;
  value: number;
}

/** Signals over a stretch. */
export interface StripReply {
  begin: number;
  /** True if every sample is drawn; else the least and the greatest value of each pixel. */
  raw: boolean;
  /** The reason for each signal that the dataset lacks, by its number. */
  missing: Record<string, string>;
}

/** The arrays of StripReply. */
export interface StripArrays {
  /** Positions, counted from `begin`. */
  x: Float32Array;
  /** Above 0 where the brush selects a sample. */
  lit: Float32Array;
  /** The signals that are present, by their numbers. */
  [name: string]: Float32Array;
}

/** Signals over the samples of a dataset that `brush` selects, or from `begin` to `end`. */
export interface AskedStatistics {
  dataset: number;
  signals: SignalName[];
  begin?: number;
  end?: number;
  brush?: SampleSelection | null;
}

/** Numbers on each signal. */
export interface StatisticsReply {
  statistics: StatisticsRow[];
}

/** Numbers on a signal over a stretch. */
export interface StatisticsRow {
  samples: number | null;
  least: number | null;
  mean: number | null;
  greatest: number | null;
  rms: number | null;
}

/** The sample of a dataset nearest to a position, moved on by `step` samples. */
export interface AskedCursor {
  dataset: number;
  position: number;
  signals: SignalName[];
  step?: number;
}

/** A sample with its position and the value of each signal. */
export interface CursorReply {
  sample: number;
  position: number;
  values: (number | null)[];
}

/** The errors of a criterion on a dataset; `both` fits the bins to those at the start, too. */
export interface AskedScatter {
  dataset: number;
  criterion?: number;
  only?: SampleSelection | null;
  brush?: SampleSelection | null;
  both?: boolean;
}

/** The arrays of ScatterReply. */
export interface ScatterArrays {
  sample: Float32Array;
  position: Float32Array;
  measured: Float32Array;
  now: Float32Array;
  start: Float32Array;
  lit: Float32Array;
  edges: Float32Array;
  beyond: Float32Array;
  after: Float32Array;
  before: Float32Array;
  brushed: Float32Array;
}

/** Signals of a dataset at samples to draw over each other, `most` of them. */
export interface AskedPoints {
  dataset: number;
  signals: SignalName[];
  criterion?: number;
  only?: SampleSelection | null;
  brush?: SampleSelection | null;
  most?: number;
}

/** Signals at the same samples. */
export interface PointsReply {
  begin: number;
}

/** The arrays of PointsReply. */
export interface PointsArrays {
  /** 1 at samples that the brush selects. */
  lit: Float32Array;
  /** Of the samples, counted from `begin`. */
  position: Float32Array;
  /** The signals that the dataset has, by their numbers. */
  [name: string]: Float32Array;
}

/** A dataset by its number, which counts from 0. */
export interface AskedSignals {
  dataset: number;
}

/** The signals of a dataset. */
export interface SignalRows {
  signals: SignalRow[];
}

/** A signal that can be drawn, and the group of the list in which it is. */
export interface SignalRow {
  kind: "channel" | "target" | "node" | "start" | "error" | "start error";
  name: string;
  unit: string;
  label: string;
  group: string;
}

/** The value `cell` of a parameter, by its number in C order, and the criterion whose errors are shown. */
export interface AskedInforming {
  name: string;
  cell: number;
  criterion?: number;
}

/** Samples that inform a value. */
export interface InformingReply {
  datasets: InformingRow[];
  /**
   * Number of the dataset with most of them, of training data if these have any; missing without samples, as the arrays
   * are.
   */
  most?: number;
}

/** The samples of a dataset that inform a value, and their mean errors. */
export interface InformingRow {
  number: number;
  dataset: string;
  use: string;
  samples: number;
  /** Number of stretches. */
  count: number;
  /** Begin and end of the longest ones. */
  stretches: [number, number][];
  meanBefore: number | null;
  meanNow: number | null;
}

/** The arrays of InformingReply. */
export interface InformingArrays {
  /** Place of lookups near the grid point along the first axis, in that dataset. */
  x?: Float32Array;
  /** Place along the second axis; empty without one. */
  y?: Float32Array;
  /** Weight of the value in each lookup. */
  weight?: Float32Array;
}

/** The samples of a dataset that `brush` selects, or those from `begin` to `end`. */
export interface AskedPassed {
  dataset: number;
  begin?: number;
  end?: number;
  brush?: SampleSelection | null;
}

/** Number of samples, and by table the weight of each value in them. */
export interface PassedReply {
  samples: number;
}

/** The arrays of PassedReply. */
export interface PassedArrays {
  [name: string]: Float32Array;
}

/** The samples of a dataset that `brush` selects. */
export interface AskedConditions {
  dataset: number;
  brush: SampleSelection;
}

/** Conditions of a project file for brushed samples; one that it cannot express is empty. */
export interface BrushedConditions {
  /** Condition that keeps only these samples, in addition to the one that the dataset has. */
  where: string;
  /** Condition that leaves them out. */
  outside: string;
  /** Condition for the weights of a criterion. */
  region: string;
  /** Why `where` and `outside` are empty. */
  reason: string;
  /** Why `region` is empty. */
  regionReason: string;
}

/** A parameter, and the criterion whose errors are shown. */
export interface AskedCoverage {
  name: string;
  criterion?: number;
}

/** The arrays of CoverageReply. */
export interface CoverageArrays {
  /** Mean error over the samples that inform each value. */
  error?: Float32Array;
  /** Place of lookups along the first axis. */
  x?: Float32Array;
  /** Place along the second axis. */
  y?: Float32Array;
}

/** The sample of a dataset nearest to a position, moved on by `step` samples, and a criterion. */
export interface AskedSplit {
  dataset: number;
  position: number;
  criterion?: number;
  step?: number;
}

/** The error of a criterion at a sample, and what makes it up. */
export interface SplitError {
  dataset: number;
  criterion: number;
  sample: number;
  position: number;
  node: string;
  unit: string;
  measured: number | null;
  difference: ValueChange;
  nodes: NodeValue[];
  inputs: InputValue[];
  corrections: CorrectionRow[];
}

/** A value at the start and at the present values. */
export interface ValueChange {
  start: number | null;
  now: number | null;
}

/** A node with its value at the start and at the present values. */
export interface NodeValue {
  name: string;
  unit: string;
  start: number | null;
  now: number | null;
}

/** An input with its channel and value. */
export interface InputValue {
  name: string;
  channel: string;
  unit: string;
  value: number | null;
}

/** The change of a table that alone would take an error away, to first order. */
export interface CorrectionRow {
  parameter: string;
  unit: string;
  /** Of the error by all values of the table. */
  slope: number | null;
  change: number | null;
  /** The part of the change within the bounds. */
  allowed: number | null;
  /** Why the change is not possible. */
  obstacle: "" | "does not act" | "locked" | "bounds";
  /** Of the span of the table. */
  share: number | null;
  /** What the lookup returns. */
  value: number | null;
  /** Number of the value with the largest weight. */
  cell: number;
  /** That look the table up. */
  nodes: string[];
  free: boolean;
}

/** A dataset and a criterion, and how many samples are wanted. */
export interface AskedWorst {
  dataset: number;
  criterion?: number;
  count?: number;
}

/** Samples with the largest errors, the worst first, and the error of all samples of that use. */
export interface WorstSamples {
  samples: WorstRow[];
  rmse: number | null;
}

/** A sample with a large error; `start` is the one at the start. */
export interface WorstRow {
  sample: number;
  position: number;
  inputs: (number | null)[];
  measured: number | null;
  error: number | null;
  start: number | null;
}

/** The course of the running or last calibration; `lines` are called `rmse 0`, `cost 0`, by start. */
export interface RunProgress {
  starts: StartRow[];
  tables: CoarseTable[];
  steps: StepRow[];
}

/** The search from one start: its last accepted step, or its end; and the stages that it went through. */
export interface StartRow {
  start: number;
  state: string;
  stage: string;
  iterations: number;
  before: number | null;
  cost: number | null;
  rmse: number | null;
  seconds: number;
  stages: StageRow[];
}

/** A stage of a search, and the number of steps before it. */
export interface StageRow {
  name: string;
  begin: number;
}

/** A coarse picture of a table; `start` are the initial values of a curve. */
export interface CoarseTable {
  name: string;
  unit: string;
  ends: [number, number][];
  values: number[][];
  start: number[][];
}

/** A step of the sequence, with the last accepted step of the search in it. */
export interface StepRow {
  name: string;
  state: "running" | "done" | "waiting";
  iterations: number;
  cost: number | null;
  rmse: number | null;
}

/** The arrays of RunProgress. */
export interface RunProgressArrays {
  [name: string]: Float32Array;
}

/** The end of the last run and of the last cross-validation. */
export interface RunOutcome {
  /** A sentence on an interrupted run that can be resumed; empty if there is none. */
  resumable: string;
  result: RunResult | null;
  validation: FoldsTable | null;
  /** Number of files with training data, which can be the folds of a cross-validation. */
  files: number;
}

/** The result of a run, and its remarks. */
export interface RunResult {
  run: number;
  status: string;
  message: string;
  /** Rows of text, the heading first. */
  quality: string[][];
  /** Start, and distance of its end from the best one. */
  distances: [number, number | null][];
  warnings: string[];
  shifts: ShiftRow[];
  smoothness: SmoothnessRow[];
  breakpoints: MovedAxis[];
  /** Sentences on surrogates that are used outside of their data. */
  extrapolations: string[];
  free: number;
  fixed: number;
  iterations: number;
  evaluations: number;
  /** By phase. */
  seconds: Record<string, number | null>;
  /** Checkpoints from which it was continued. */
  resumed: string[];
}

/** The time shift of a channel that a run has estimated. */
export interface ShiftRow {
  dataset: string;
  channel: string;
  shift: number;
}

/** Smoothness of a parameter by axis, chosen from the data. */
export interface SmoothnessRow {
  parameter: string;
  factors: Record<string, number>;
}

/** Breakpoints of a free axis before and after a run. */
export interface MovedAxis {
  axis: string;
  before: number[];
  after: number[];
}

/** A cross-validation: rows of text, the heading first, and sentences. */
export interface FoldsTable {
  table: string[][];
  summary: string[];
}

/** Errors of the last run by file. */
export interface ErrorsByFile {
  run: number | null;
  /** Rows of text, the heading first. */
  rows: string[][];
  /** Number of rows that are not listed. */
  more: number;
  /** True if a dataset has several files. */
  several: boolean;
}

/** The sets that can be compared: present values, runs and cross-validations, the last one first, and the start. */
export interface SetHistory {
  rows: SetRow[];
}

/** An entry of the history. */
export interface SetRow {
  /** `now`, `start`, the number of a run, or empty for a cross-validation, which has no values. */
  key: string;
  title: string;
  /** In a few words. */
  detail: string;
  /** When it ended, in s since 1970; 0 if it did not run. */
  ended: number;
  scores: SetScore[];
  /** Of a cross-validation: standard deviation of the RMSE over the folds, by criterion. */
  spread: (number | null)[];
  /** What a cross-validation says about overfitting. */
  remark: string;
}

/** RMSE of a criterion on training data and on test data; of a cross-validation, on data that were held out. */
export interface SetScore {
  criterion: string;
  unit: string;
  training: number | null;
  test: number | null;
}

/** Two sets of values. */
export interface ComparedValues {
  first: SourceName;
  second: SourceName;
}

/** A set of values as a page names it. */
export interface SourceName {
  /** "now", "start", the number of a run, or "file". */
  from?: string | number;
  /** A file of the folder. */
  file?: string;
  /** The A2L file of an image, if it is known. */
  a2l?: string | null;
}

/** The differences of two sets of values, the relatively largest first. */
export interface ValueChanges {
  changes: ComparedTable[];
  scores: ComparedScore[];
}

/** The difference of a table in two sets of values, in C order. */
export interface ComparedTable {
  name: string;
  kind: string;
  unit: string;
  description: string;
  largest: number;
  mean: number;
  /** Largest difference, relative to the largest value. */
  relative: number;
  atBound: number;
  axes: AxisPoints[];
  first: number[];
  second: number[];
  /** Numbers of the values that differ, the largest difference first. */
  biggest: number[];
  /** Numbers of the values at a bound. */
  bound: number[];
}

/** Errors of a criterion with two sets of values. */
export interface ComparedScore {
  use: string;
  unit: string;
  criterion: string;
  first: number | null;
  second: number | null;
  largest: number | null;
}

/** Values of a set: numbers of the values to take by parameter, null for all; what is not named stays as it is. */
export interface AskedChoice {
  source: SourceName;
  cells: Record<string, number[] | null>;
}

/** The errors with the chosen values, number of values that change, and the tables that belong together, if any. */
export interface ChoiceScores {
  scores: ChoiceScore[];
  count: number;
  together: MovedTogether | null;
}

/** The error of a criterion now, and with the chosen values. */
export interface ChoiceScore {
  use: string;
  criterion: string;
  unit: string;
  now: number | null;
  then: number | null;
}

/** Tables that have to be taken together. */
export interface MovedTogether {
  /** The chosen ones first. */
  names: string[];
  /** Number of values that change if these are taken. */
  count: number;
  /** Error of the first criterion with the chosen tables only. */
  alone: number | null;
  /** With all of these. */
  together: number | null;
  /** Of both. */
  unit: string;
}

/** The limits of the project with two sets of values. */
export interface LimitRows {
  rows: LimitRow[];
}

/** A limit: what it is about, its range in words, and its unit. */
export interface LimitRow {
  name: string;
  text: string;
  unit: string;
  first: LimitState;
  second: LimitState;
}

/** A limit with one set of values. */
export interface LimitState {
  /** How far the worst value is beyond it; 0 if it holds, null if that is not known. */
  excess: number | null;
  /** Number of values at the limit. */
  active: number;
  /** Where the worst value is, in words. */
  worst: string;
}

/** Values that the data of the last run cannot determine; without a run, only empty lists. */
export interface TrustReply {
  directions: UndeterminedDirection[];
  remedies: RemedyRow[];
  /** Sentences on values that are determined together only. */
  coupled?: string[];
  /** On the values that nothing determines. */
  sentence?: string;
  /** What to do about them. */
  advice?: string;
  /** Number of directions that nothing determines. */
  dimension?: number;
  /** Limits that hold values. */
  holdings?: string[];
  noise?: NoiseRow[];
  remark?: string;
  /** The effective number of values that the data alone determine. */
  freedom?: number | null;
  /** Number of free values. */
  values?: number;
}

/** A direction of the values that the data do not determine. */
export interface UndeterminedDirection {
  sentence: string;
  remedy: string;
  remedies: RemedyRow[];
  exact: boolean;
  deviation: number | null;
  parameters: string[];
}

/** A remedy as changes of the project file; `applied` if the file has them already. */
export interface RemedyRow {
  kind: string;
  title: string;
  changes: [Path, Toml | null][];
  applied: boolean;
}

/** Standard deviation of the errors of a criterion. */
export interface NoiseRow {
  criterion: string;
  value: number | null;
}

/** A pin of a parameter at a grid point. */
export interface AskedPin {
  parameter: string;
  at: number[];
}

/** The effect of a pin by table; empty if nothing determines the value, or there are too many values. */
export interface PinnedReply {
  rows: PinnedRow[];
}

/** Median standard deviation of a table, before and after a pin. */
export interface PinnedRow {
  name: string;
  unit: string;
  before: number | null;
  after: number | null;
}

/** The project file and the function: tables and text of the former, name and text of the latter. */
export interface SettingsReply {
  settings: Record<string, Toml>;
  text: string;
  file: string;
  function: string;
}

/** The sections of the project file in the documented order. */
export interface SchemaReply {
  sections: SectionRow[];
}

/** A section of the project file, and the screen that shows it. */
export interface SectionRow {
  name: string;
  help: string;
  type: string;
  default: string;
  required: boolean;
  unit: string;
  holds: string;
  by: string;
  form: KeyForm;
  heading: string;
  screen: "data" | "function" | "parameters" | "optimization" | "results" | "design";
}

/** The kind of a value, and what its field needs. */
export interface KeyForm {
  kind:
    | "text"
    | "number"
    | "integer"
    | "flag"
    | "choice"
    | "texts"
    | "numbers"
    | "pair"
    | "table"
    | "entry"
    | "entries"
    | "named"
    | "either"
    | "list"
    | "toml";
  title?: string;
  least?: number | null;
  above?: number | null;
  most?: number | null;
  /** Texts in place of a number. */
  words?: string[];
  options?: string[];
  /** True for whole numbers among texts. */
  numbers?: boolean;
  /** The only names of a table. */
  names?: string[];
  /** Form of the values of a table. */
  values?: KeyForm;
  keys?: KeyRow[];
  /** What messages call an entry. */
  word?: string;
  /** True if one table may stand for a list of one. */
  single?: boolean;
  /** Alternatives. */
  forms?: KeyForm[];
  /** Form of the elements of a list. */
  item?: KeyForm;
}

/** A key of the project file. */
export interface KeyRow {
  name: string;
  help: string;
  type: string;
  default: string;
  required: boolean;
  unit: string;
  /** What texts are: "channel", "condition" ... */
  holds: string;
  /** What the names of a table are. */
  by: string;
  form: KeyForm;
}

/** Names that values choose from, by what the values are: "channel", "node", "image" ... */
export interface NamesReply {
  names: Record<string, string[]>;
}

/** The files of all datasets, and the channels that the project needs. */
export interface DataFiles {
  datasets: DatasetFiles[];
  inputs: MappedInput[];
}

/** A dataset of the project file, numbered from 1 on, with its files. */
export interface DatasetFiles {
  number: number;
  name: string;
  use: string;
  files: RecordingFile[];
}

/** A file of a dataset, as far as it can be read. */
export interface RecordingFile {
  name: string;
  channels: ChannelRow[];
  /** Of the file in bytes. */
  size?: number;
  /** Number of samples of the longest table. */
  samples?: number;
  /** Between samples in s; of several groups of channels, the shortest. */
  step?: number | null;
  /** Of channels with time stamps, if there are several. */
  groups: ChannelGroup[];
  /** Duration in s. */
  length?: number | null;
  /** Share of missing values in the channel that has most of them. */
  missing?: number;
  /** That channel. */
  sparsest?: string;
  /** Why it cannot be read. */
  error?: string;
  /** Why it is not described. */
  note?: string;
}

/** A channel of a file with the range of its values; `group` names the table if there are several. */
export interface ChannelRow {
  name: string;
  group: string;
  unit: string;
  least: number | null;
  greatest: number | null;
}

/** A group of channels with time stamps of its own; `step` is the usual time between them in s. */
export interface ChannelGroup {
  name: string;
  step: number;
}

/** An input of the function, or the target of the criterion `number`, with its channel. */
export interface MappedInput {
  name: string;
  role: "input" | "target";
  unit: string;
  channel: string;
  number?: number;
}

/** The errors of a criterion by file, as lines of a number of pixels. */
export interface AskedErrors {
  criterion?: number;
  pixels?: number;
}

/** The errors by file. */
export interface FileErrors {
  criterion: string;
  unit: string;
  files: FileRow[];
  /** Largest error of the bins of the histograms, to either side. */
  reach: number;
  shifts: EstimatedShift[];
}

/** A file of a dataset that is used, with the errors of a criterion. */
export interface FileRow {
  /** Number of the dataset among those that are used; the first is 0. */
  dataset: number;
  name: string;
  use: string;
  timed: boolean;
  /** Time stamp of the first sample in s, as recorded; of data without time 0. */
  begin: number;
  end: number;
  /** That are scored. */
  samples: number;
  /** Now; `before` with the initial values. */
  rmse: number | null;
  before: number | null;
  largest: number | null;
  /** Begin, end and RMSE of the worst stretch, in s, of data without time in samples from 1 on. */
  worst: [number, number, number] | null;
  /** Number of stretches in which a channel that the function reads is missing, and their length together. */
  gaps: [number, number];
}

/** The shift of a channel that the last run has estimated. */
export interface EstimatedShift {
  dataset: number;
  channel: string;
  shift: number;
}

/** The arrays of FileErrors. */
export interface FileErrorsArrays {
  /** By number of the file least and greatest error of each pixel in turn, and `bins N` its histogram. */
  [name: string]: Float32Array;
}

/** Signals over all files, as lines of a number of pixels. */
export interface AskedFileLines {
  signals: SignalName[];
  pixels?: number;
}

/** Signals over all files; `lines` are called `SIGNAL FILE` by their numbers. */
export interface FileLines {
  signals: SignalFacts[];
}

/** A signal over all files. */
export interface SignalFacts {
  name: string;
  unit: string;
  least: number | null;
  greatest: number | null;
  /** Why it cannot be drawn; empty if it can. */
  missing: string;
  /** By number of the file begin and end of its longest stretches without values. */
  gaps: Record<string, [number, number][]>;
}

/** The arrays of FileLines. */
export interface FileLinesArrays {
  [name: string]: Float32Array;
}

/** A channel, and the criterion whose error tells its shift. */
export interface AskedScan {
  channel: string;
  criterion?: number;
}

/** The error over a shift of a channel beyond that of the project file, see `ShiftScan`. */
export interface ScanReply {
  channel: string;
  criterion: string;
  unit: string;
  best: number;
  deviation: number | null;
  seen: boolean;
  atTheEnd: boolean;
  samples: number;
}

/** The arrays of ScanReply. */
export interface ScanArrays {
  shifts: Float32Array;
  rmse: Float32Array;
}

/** Proposals for all that the project lacks, and why its initial files say nothing about some of it. */
export interface ProposalRows {
  proposals: ProposalRow[];
  problems: string[];
}

/** Something that the project lacks, with the keys that provide it; one of them may be chosen. */
export interface ProposalRow {
  title: string;
  changes: [Path, Toml | null][];
  choice: KeyChoice | null;
}

/** A key, by path, whose value the user chooses among options. */
export interface KeyChoice {
  path: (string | number)[];
  options: string[];
}

/** The files that can be the function, and the one that is. */
export interface KnownFunctions {
  files: string[];
  chosen: string;
}

/** The function of the project as its importer shows it: blocks or source text, and as far as it can be imported. */
export interface ImportedFunction {
  file: string;
  subsystem: string;
  /** Channels or formulas in place of blocks. */
  bind: Record<string, string>;
  /** With values of variables. */
  files: string[];
  chosen: ImportChoice;
  problems: ImportProblem[];
  sources?: SourceText[];
  name?: string;
  version?: string;
  blocks?: BlockRow[];
  subsystems?: string[];
  /** Formula text. */
  lines?: FormulaLine[];
  /** True if all of it can be imported. */
  whole?: boolean;
  /** In s. */
  step?: number | null;
  inputs?: NamedUnit[];
  outputs?: NamedUnit[];
  parameters?: CalibratableParameter[];
  notes?: string[];
  /** Number of blocks. */
  total?: number;
  supported?: number;
  /** Number of blocks that no output depends on. */
  unreached?: number;
  solver?: string;
  blocking?: BlockingBlock[];
  undefined?: UndefinedVariable[];
  /** Files that supply what is missing. */
  proposals?: FileProposal[];
  /** Paths of blocks that depend on each other. */
  loops?: string[][];
  stopped?: ImportProblem[];
  classes?: ClassChoice[];
  tasks?: TaskRow[];
  /** Names that are not declared. */
  missing?: string[];
  /** Methods in the order of their calls. */
  calls?: string[];
  startup?: string[];
  schedule?: ScheduleRow[];
  states?: StateRow[];
  places?: SourcePlace[];
  /** Of the recordings in s, if a block needs a fixed step of the function. */
  dataStep?: number | null;
}

/** The part of an ASCET model that the project chooses: a class with its methods, or tasks. */
export interface ImportChoice {
  class: string;
  methods: string[];
  tasks: string[];
}

/** A problem of an import. */
export interface ImportProblem {
  /** Number of the file that it is about; -1 for none. */
  source: number;
  /** Line of the file; 0 for none. */
  line: number;
  /** Place within the file, such as a block. */
  place: string;
  message: string;
  remedy: string;
  /** The whole message. */
  text: string;
}

/** A file of source text. */
export interface SourceText {
  file: string;
  text: string;
}

/** A block of the tree; the blocks of a subsystem follow it, one level deeper. */
export interface BlockRow {
  /** Path from the imported system; a slash within a name is doubled. */
  path: string;
  name: string;
  type: string;
  depth: number;
  /** Number of blocks directly within it. */
  inner: number;
  /** The field that says most about it, empty if there is none. */
  field: string;
  /** That field as written. */
  detail: string;
  state: "supported" | "bound" | "undefined" | "unsupported" | "unused" | "unreached";
}

/** A line of formula text. */
export interface FormulaLine {
  /** The line. */
  text: string;
  /** Name of the node in the model whose statement begins here; empty for other lines. */
  node: string;
  /** Where it comes from: the path of a block. */
  path: string;
}

/** A node, channel or port with its unit. */
export interface NamedUnit {
  name: string;
  unit: string;
}

/**
 * A parameter that can be calibrated: kind, shape, range of values, limits (None for none) and origin. A `locked`
 * parameter keeps its values unless it is selected by name.
 */
export interface CalibratableParameter {
  name: string;
  kind: string;
  shape: number[];
  smallest: number;
  largest: number;
  unit: string;
  lower: number | null;
  upper: number | null;
  locked: boolean;
  source: string;
}

/** A block that is not supported; `undefined` are variables that it lacks. */
export interface BlockingBlock {
  path: string;
  type: string;
  why: string;
  remedy: string;
  stops: boolean;
  undefined: string[];
  /** A fixed step of the function is what it lacks. */
  needsStep: boolean;
}

/** A variable without a value, and the blocks that use it. */
export interface UndefinedVariable {
  name: string;
  paths: string[];
  reason: string;
}

/** A file or folder that supplies what is missing, with the key of `[model]` that takes it; one of the values. */
export interface FileProposal {
  key: "parameters" | "folders";
  values: string[];
  text: string;
}

/** A class with the methods that a step can call. */
export interface ClassChoice {
  name: string;
  methods: string[];
}

/** A task with its period in s and its methods. */
export interface TaskRow {
  name: string;
  period: number | null;
  methods: string[];
}

/** A task that is imported, with its period and delay in s. */
export interface ScheduleRow {
  name: string;
  period: number;
  delay: number;
  methods: string[];
}

/** A state with its first value; null if that is calculated. */
export interface StateRow {
  name: string;
  initial: number | null;
}

/** The line at which a node or a parameter is declared, with the number of its file. */
export interface SourcePlace {
  name: string;
  source: number;
  line: number;
}

/** Words that messages are about. */
export interface SpellingRows {
  spellings: SpellingRow[];
}

/** A word at a character of the formula text, and a known name like it. */
export interface SpellingRow {
  line: number;
  column: number;
  word: string;
  similar: string;
}

/** The nodes of the function from inputs to outputs. */
export interface FunctionFlow {
  inputs: string[];
  nodes: FlowNode[];
  outputs: string[];
}

/** A node with what computes it; `kind` is that of its table, or its operation. */
export interface FlowNode {
  name: string;
  sources: string[];
  tables: string[];
  kind: string;
}

/** The parts of the file that can be imported by themselves, largest first. */
export interface ImportableParts {
  parts: ImportablePart[];
}

/** A part of the file that can be imported by itself. */
export interface ImportablePart {
  path: string;
  blocks: number;
  inputs: string[];
  outputs: string[];
}

/** A formula over channels. */
export interface AskedFormula {
  text: string;
}

/** The channels that a formula reads, and what is wrong with it. */
export interface FormulaReads {
  channels: ReadChannel[];
  problem: string;
}

/** A channel that a formula reads, with its range if the recordings have it, else a question that offers another. */
export interface ReadChannel {
  name: string;
  least: number | null;
  greatest: number | null;
  known: boolean;
  guess: string;
}

/** The function of the project in a file; what follows `problems` is known if it can be read. */
export interface ProjectFunction {
  file: string;
  reference: string;
  kind: string;
  named: boolean;
  function: string;
  functions: string[];
  choices: string[];
  /** Text of the file; empty if it is not one of text. */
  source: string;
  /** Names and texts that the file states of itself. */
  facts: [string, string][];
  whole: boolean;
  problems: ImportProblem[];
  inputs?: FunctionPort[];
  outputs?: NamedUnit[];
  parameters?: CalibratableParameter[];
  states?: StateRow[];
  notes?: string[];
  step?: number | null;
  solver?: string;
  /** True if code of the file runs with the function. */
  runs?: boolean;
  lines?: FormulaLine[];
}

/** An input of a function; `later` tells that only later samples use its value. */
export interface FunctionPort {
  name: string;
  unit: string;
  default: number | null;
  later: boolean;
}

/** The functions that formula text may call. */
export interface CallableFunctions {
  functions: CalledFunction[];
}

/** A function that formula text may call; `memory` tells if it has states, as far as it can be read. */
export interface CalledFunction {
  file: string;
  reference: string;
  kind: string;
  named: boolean;
  function: string;
  functions: string[];
  choices: string[];
  name: string;
  calls: FunctionCall[];
  parameters: CalibratableParameter[];
  notes: string[];
  problems: ImportProblem[];
  memory?: boolean;
  runs?: boolean;
}

/** The way in which formula text calls an output. */
export interface FunctionCall {
  signature: string;
  unit: string;
}

/** The names that formula text can use. */
export interface CompletionRows {
  completions: CompletionRow[];
}

/** A name that formula text can use, and how it is called or its unit. */
export interface CompletionRow {
  label: string;
  kind: "function" | "parameter" | "node" | "input";
  detail: string;
}

/** The surrogates of the project, then training files whose surrogate it does not use. */
export interface SurrogateRows {
  surrogates: SurrogateRow[];
}

/** A surrogate of the project, or a training file beside it; what follows `problem` is known of a trained one. */
export interface SurrogateRow {
  name: string;
  file: string;
  state: "trained" | "not trained" | "unreadable";
  /** Its training file, if there is one. */
  training: string;
  /** Why that cannot be used. */
  trainingProblem: string;
  /** Why the file cannot be read. */
  problem?: string;
  inputs?: string[];
  output?: string;
  unit?: string;
  /** Number of basis functions. */
  centres?: number;
  step?: number | null;
  stability?: string;
  deviation?: string;
  remarks?: string[];
  quality?: SurrogateQualityRow[];
  /** True if it knows where its training data lie. */
  bounded?: boolean;
}

/** Errors of a surrogate on a dataset. */
export interface SurrogateQualityRow {
  dataset: string;
  use: string;
  mode: string;
  samples: number;
  rmse: number | null;
  r2: number | null;
  max_abs: number | null;
}

/** Uses of surrogates outside of their training data, by surrogate and dataset. */
export interface ValidityRows {
  rows: ValidityRow[];
}

/** The share of samples of a dataset at which a surrogate is used outside of its training data. */
export interface ValidityRow {
  name: string;
  dataset: string;
  use: string;
  samples: number;
  outside: number | null;
  worst: FarthestSample | null;
  share: number;
  text: string;
}

/** The sample of a dataset that is farthest outside of the training data. */
export interface FarthestSample {
  sample: number;
  piece: number;
  time: number | null;
  input: string;
  value: number | null;
  end: number | null;
  sentence: string;
}

/** Extensions that values can be written as. */
export interface ExportFormats {
  /** All, those of the project first. */
  formats: string[];
  /** Those of the project. */
  own: string[];
  /** The results folder. */
  folder: string;
  /** True if it has the files of a run. */
  stored: boolean;
  /** True if files can be opened on the desktop of this machine. */
  opens: boolean;
}

/** Files that are written into the results folder. */
export interface ExportCommand {
  /** Extensions of files with the present values. */
  formats?: string[];
  /** The report on them. */
  report?: boolean;
  /** A script that repeats the run. */
  script?: boolean;
  /** All files of a run. */
  whole?: boolean;
  /** The report on the run whose files are in the results folder. */
  stored?: boolean;
  /** Extension of a file with all nodes over all datasets; empty for none. */
  simulation?: string;
  /** Replace another file with the name of the script. */
  force?: boolean;
}

/** Files that were written, remarks, and values that an image does not store exactly. */
export interface ExportedFiles {
  files: string[];
  findings: string[];
  rounded: RoundedRow[];
}

/** A label whose values a file does not store exactly: asked for, stored, and how many differ. */
export interface RoundedRow {
  name: string;
  differ: number;
  total: number;
  largest: number | null;
  place: string;
  asked: string;
  stored: string;
}

/** A file that would be replaced; nothing was written. */
export interface ExistingFile {
  exists: string;
}

/** A file of the project's folder to open; empty for the results folder. */
export interface OpenedFile {
  file?: string;
}

/** The choices of the screen of the control unit. */
export interface ControlUnit {
  /** In the project file; empty if nothing is rounded. */
  method: "" | "nearest" | "joint";
  /** The largest distance of a rounded value from the fit, in steps. */
  maxShift: number;
  /** The A2L file in the project file. */
  storage: string;
  /** True if the initial values are those of an image, whose A2L file states their storage. */
  image: boolean;
  /** A2L files of the folder. */
  descriptions: string[];
  /** The free parameters, `count` of them. */
  rows: StorageRow[];
  count: number;
  /** The C compiler of this computer; empty if there is none. */
  compiler: string;
  /** This machine, as FMI 3.0 names it. */
  platform: string;
  /** Other machines for which an FMU can have a library. */
  platforms: ("x86_64-windows" | "x86_64-linux" | "aarch64-linux" | "x86_64-darwin" | "aarch64-darwin")[];
  /** Why it cannot on this computer; empty if it can. */
  cross: string;
  /** Endings of calibration files that can be written, those of the project first. */
  formats: string[];
  /** Those of the project. */
  own: string[];
  /** Where files are written, unless another one is named. */
  folder: string;
}

/** A free parameter, and how it is stored. */
export interface StorageRow {
  name: string;
  unit: string;
  /** Number of its values. */
  values: number;
  /** Distance of storable values; null if it is not known. */
  step: number | null;
  /** Of a stored number; 0 if unknown. */
  bits: number;
  /** The end of the range that can be stored; null if it is unknown. */
  least: number | null;
  /** Its other end. */
  largest: number | null;
  /** The step in the project file, which precedes that of the A2L file. */
  typed: number | null;
  /** Why it is not rounded, a clause; empty if it is. */
  reason: string;
}

/** A set of values that is rounded. */
export interface AskedRounding {
  source: SourceName;
  method: "joint" | "nearest";
}

/** A rounded set of values. */
export interface RoundingReply {
  /** By which the values are rounded. */
  method: "joint" | "nearest";
  errors: RoundedError[];
  /** Those with the largest share first. */
  labels: RoundedLabel[];
  /** Labels whose finer storage is worth a trial. */
  trials: string[][];
  /** The label that would profit most from it; empty if none stands out. */
  advice: string;
  /** Bytes of all rounded labels; null if unknown. */
  size: number | null;
  findings: string[];
  seconds: number;
  /** Number of the run whose fit was rounded, in place of values that the run had rounded; 0 if none had. */
  run: number;
}

/** RMSE of a criterion on a dataset, before and after rounding by either method. */
export interface RoundedError {
  criterion: string;
  dataset: string;
  use: string;
  unit: string;
  unrounded: number | null;
  nearest: number | null;
  joint: number | null;
}

/** The rounding of a parameter, or of the breakpoints of an axis. */
export interface RoundedLabel {
  name: string;
  step: number;
  bits: number;
  values: number;
  /** Values that are not the storable ones nearest to the fit. */
  moved: number;
  /** The largest distance from the fit, in steps. */
  largestShift: number | null;
  /** Of what rounding costs. */
  share: number | null;
}

/** A set of values that is rounded with finer storage of some labels. */
export interface AskedTrial {
  source: SourceName;
  method: "joint" | "nearest";
  labels: string[];
}

/** Labels that are stored in 256 steps for each one. */
export interface FinerRow {
  /** By name. */
  steps: Record<string, number>;
  /** True if their bits are known to be 8. */
  bits: boolean;
  /** In the order of those of the rounding. */
  errors: RoundedError[];
  /** Bytes of all rounded labels; null if unknown. */
  size: number | null;
}

/** The function as C code with a set of values. */
export interface AskedCode {
  source: SourceName;
  /** How the values are rounded; empty for the values as they are. */
  rounding?: "" | "nearest" | "joint";
  precision?: "double" | "float";
  name?: string;
  /** Compile the code and compare it with the simulation. */
  check?: boolean;
}

/** C code. */
export interface CodeReply {
  /** Of the code. */
  name: string;
  /** Of its file. */
  text: string;
  /** Of the whole file. */
  lines: number;
  /** Bytes of its tables. */
  size: number;
  findings: string[];
  /** Null if it was not compiled. */
  compared: ComparedCode | null;
}

/** Compiled code over all datasets, in comparison with the simulation. */
export interface ComparedCode {
  compiler: string;
  samples: number;
  exact: boolean;
  outputs: DeviationRow[];
}

/** The largest deviation of an output from the simulation, null if only one of both is NaN; and its range. */
export interface DeviationRow {
  name: string;
  unit: string;
  largest: number | null;
  range: number;
}

/** Files that are written together. */
export interface UnitCommand {
  source: SourceName;
  /** In which the function is written. */
  languages: ("c" | "fmu" | "m")[];
  /** Endings of calibration files. */
  formats: string[];
  /** How the values are rounded; empty for the values as they are. */
  rounding?: "" | "nearest" | "joint";
  precision?: "double" | "float";
  name?: string;
  /** Version of FMI. */
  fmi?: 2 | 3;
  /** Whether inputs of an FMU that are set before a step count at its start or its end. */
  inputs?: "start" | "end";
  /** Of an FMU in s; null for that of the function or its data. */
  step?: number | null;
  /** Machines for which an FMU has a library in addition to this one. */
  platforms?: ("x86_64-windows" | "x86_64-linux" | "aarch64-linux" | "x86_64-darwin" | "aarch64-darwin")[];
  /** Of the project's folder. */
  folder?: string;
  /** Write what the function calculates over all data, as MDF. */
  signals?: boolean;
  /** Replace files that exist with another content. */
  force?: boolean;
}

/** Files that were written, relative to the folder of the project. */
export interface WrittenUnit {
  files: string[];
  findings: string[];
  compared: ComparedCode | null;
}

/** Files that would be replaced; nothing was written. */
export interface ExistingFiles {
  existing: string[];
}

/** The choices of a design, and the outcome of the last one. */
export interface Designs {
  /** True if the training data are recordings over time. */
  timed: boolean;
  /** True if the function remembers, so that a drive settles it and points do not. */
  memory: boolean;
  /** The free ones. */
  parameters: DesignParameter[];
  /**
   * Sentences on joint changes that the data of the last run hardly notice, in the order of their numbers, the
   * undetermined ones first.
   */
  directions: string[];
  /** Null if there is none yet. */
  found: FoundDesign | null;
}

/** A free parameter; `without_data` grid points have no samples. */
export interface DesignParameter {
  name: string;
  unit: string;
  values: number;
  withoutData: number;
}

/** The outcome. */
export interface FoundDesign {
  /** True if values, function or data have changed since. */
  old: boolean;
  segments: SegmentRow[];
  points: PointRow[];
  /** Of the points. */
  channels: string[];
  planned: PlannedRow[];
  /** Recordings that can go, the first is missed least. */
  drop: string[];
  /** Time before each segment, in s. */
  warmup: number;
  /** Predicted mean variance of prediction over the use, relative to now. */
  factor: number | null;
  /** Of all segments with their warm-up, or of the points on the bench, in s. */
  duration: number;
  sentences: string[];
  /** What the design leaves open, in sentences. */
  unsettled: string[];
  /** Warnings and remarks. */
  remarks: Remark[];
  tables: DesignTableRow[];
  formats: ("csv" | "xlsx" | "mf4" | "parquet" | "json")[];
  seconds: number;
  /** How many were chosen, and how many would have been; empty for a choice that has ended. */
  stopped: number[];
}

/** A piece of a recording to drive. */
export interface SegmentRow {
  file: string;
  /** Time stamp in the file at which it begins to count, in s. */
  begin: number;
  end: number;
  /** The values that it determines and the others do not. */
  settles: string;
  /** Mean variance over the use after it and those before it, relative to now. */
  left: number | null;
}

/** A steady point, with its channels in the order of the list. */
export interface PointRow {
  channels: number[];
  block: number;
  kind: string;
}

/** A planned manoeuvre, with its duration in s. */
export interface PlannedRow {
  name: string;
  duration: number;
  channels: string[];
}

/** A warning or a remark, with what to do about it. */
export interface Remark {
  severity: "error" | "warning" | "remark";
  message: string;
  remedy: string;
}

/** The standard deviations of a table now and as predicted; null if one is undetermined. */
export interface DesignTableRow {
  name: string;
  unit: string;
  /** Number of axes; tables with one or two can be drawn. */
  axes: number;
  median: [number | null, number | null];
  greatest: [number | null, number | null];
  /** Values whose deviation falls to less than a half. */
  settled: number;
}

/** A table of the last design. */
export interface AskedMap {
  name: string;
}

/** A table of the last design, and the operation over its axes. */
export interface DesignMap {
  name: string;
  unit: string;
  /** Of the table. */
  axes: DesignAxis[];
  /** For each value, true if no sample informs it; empty if unknown. */
  empty: boolean[];
  /** Where the steps of each segment begin in `way_x`, or points. */
  ways: number[];
  /** True if the ways are drives. */
  isDrive: boolean;
}

/** An axis of a table. */
export interface DesignAxis {
  input: string;
  unit: string;
  points: number[];
}

/** The arrays of DesignMap. */
export interface DesignMapArrays {
  /** At the fit, in C order. */
  values: Float32Array;
  /** Standard deviation now; infinite if undetermined. */
  before: Float32Array;
  /** As predicted. */
  after: Float32Array;
  /** Of recorded samples. */
  x: Float32Array;
  /** The same along the second axis. */
  y: Float32Array;
  /** Of the segments, one after the other, or of the points. */
  wayX: Float32Array;
  /** The same along the second axis. */
  wayY: Float32Array;
}

/** A file of the last design; `force` replaces another one. */
export interface DesignExport {
  format: "csv" | "xlsx" | "mf4" | "parquet" | "json";
  force?: boolean;
}

/** The file that was written, relative to the folder of the project. */
export interface WrittenDesign {
  file: string;
}

/** Candidates for a search, and the outcome of the last one. */
export interface MissingTerms {
  /** Of the first criterion. */
  node: string;
  unit: string;
  channels: TermChannel[];
  kinds: TermKind[];
  /** Those that can take part. */
  nodes: string[];
  /** Null if none has found anything yet. */
  found: FoundTerms | null;
}

/** A channel of the recordings; `reason` says why it takes no part, as a clause. */
export interface TermChannel {
  name: string;
  unit: string;
  reason: string;
}

/** A kind of terms, with the number of nodes at which it is tried; 0 if the data have no time, or few recordings. */
export interface TermKind {
  name: "add" | "multiply" | "map" | "lag" | "delay" | "offset";
  places: number;
}

/** The outcome of a search. */
export interface FoundTerms {
  /** True if values, function or data have changed since. */
  old: boolean;
  status: string;
  /** The verdict, a sentence. */
  message: string;
  /** RMSE of the smallest effect that would have been detected. */
  smallest: number | null;
  unit: string;
  candidates: number;
  /** Candidates that were fitted, and all that were to be; null if the search has ended. */
  stopped: [number, number] | null;
  proposals: TermRow[];
  /** Candidates that are not proposed, in words. */
  rejected: string[];
  /** Channels that took no part, with the reason. */
  excluded: [string, string][];
  remarks: string[];
  seconds: number;
}

/** A proposal. */
export interface TermRow {
  /** In words. */
  change: string;
  node: string;
  kind: "add" | "multiply" | "lag" | "delay" | "offset";
  channel: string;
  /** The second channel of a map. */
  second: string;
  training: BeforeAfter;
  heldOut: BeforeAfter;
  /** What was held out. */
  heldName: string;
  test: BeforeAfter | null;
  /** Root of the difference of the squared errors on held-out data. */
  explains: number | null;
  /** Held-out parts that the term makes better, of `parts`. */
  better: number;
  parts: number;
  /** Number of values of the term. */
  values: number;
  /** The first and the last breakpoint of a curve, each with its value. */
  ends: [number, number][];
  /** Others that the data cannot distinguish from it. */
  places: PlaceRow[];
  heldOutParts: HeldOutRow[];
  /** Of the node in the source of the function. */
  location: string;
}

/** An RMSE without a term and with it. */
export interface BeforeAfter {
  before: number | null;
  after: number | null;
}

/** A node at which a term explains as much as at the one that is proposed; `number` names it in questions. */
export interface PlaceRow {
  number: number;
  node: string;
  kind: "add" | "multiply" | "lag" | "delay" | "offset";
  change: string;
}

/** The errors on a part of the data that was held out. */
export interface HeldOutRow {
  name: string;
  samples: number;
  rmse: BeforeAfter;
}

/** A proposal, from 0, at its best place or at an equal one, from 0. */
export interface AskedTerm {
  number: number;
  place?: number | null;
}

/** A proposal in detail. */
export interface ShownTerm {
  /** Name of the new parameter; empty for a delay. */
  parameter: string;
  /** The channel, with its unit in `input_unit`. */
  input: string;
  inputUnit: string;
  /** The second channel of a map, with its unit in `second_unit`. */
  second: string;
  secondUnit: string;
  /** Breakpoints of a curve, or of the first channel of a map. */
  points: number[];
  /** Those of the second channel. */
  secondPoints: number[];
  /** The values, of a map row by row, one for each of `points`; the time constant of a lag. */
  now: number[];
  /** Standard deviation of each; null if nothing determines one. */
  deviation: (number | null)[];
  /** Of the values and their deviations; empty for a factor. */
  valueUnit: string;
  /** The value without effect. */
  neutral: number;
  /** False at an equal place, where the values are those without effect. */
  fitted: boolean;
  /** Node whose errors are drawn. */
  criterion: string;
  /** Of the errors. */
  unit: string;
  /** Samples by bin of the channel. */
  counts: number[];
  /** What changes; empty if the function has changed since. */
  files: ChangedFile[];
  /** The term as a line of formula text, for a function that is not. */
  text: string;
  /** Why it cannot be written; empty if it can. */
  reason: string;
}

/** The change of a file. */
export interface ChangedFile {
  file: string;
  lines: ChangedLine[];
}

/** A line of a changed text; `sign` is `+`, `-` or a space, `line` its number before or after, 0 for a gap. */
export interface ChangedLine {
  sign: string;
  line: number;
  text: string;
}

/** The arrays of ShownTerm. */
export interface ShownTermArrays {
  /** Of the bins. */
  edges: Float32Array;
  /** Mean error by bin without the term. */
  before: Float32Array;
  /** With it. */
  after: Float32Array;
  /** Channel of some samples. */
  x: Float32Array;
  /** Their errors without the term. */
  error: Float32Array;
}

/** The calibration files of the folder. */
export interface CalibrationFiles {
  files: ListedCalibration[];
  /** A2L files. */
  descriptions: string[];
  /** That can be written. */
  endings: string[];
  /** The initial files as the project names them. */
  initial: Toml[];
}

/** A calibration file of the folder; an image needs an A2L file. */
export interface ListedCalibration {
  name: string;
  format: string;
  image: boolean;
}

/** A set of values; an A2L file has labels alone. */
export interface AskedContents {
  source: SourceName;
}

/** The labels of a set of values, `count` of them, and what was skipped. */
export interface SetContents {
  label: string;
  rows: LabelRow[];
  count: number;
  findings: string[];
}

/** A label of a set of values, with the range of its values. */
export interface LabelRow {
  name: string;
  size: string;
  kind: string;
  unit: string;
  description: string;
  text: string;
  function: string;
  least: number | null;
  greatest: number | null;
}

/** Two sets of values, and the largest differences that count as equal. */
export interface AskedDifferences {
  first: SourceName;
  second: SourceName;
  tolerance?: number | null;
  relative?: number | null;
}

/** The labels that differ in two sets, `count` of them, of those that were compared. */
export interface SetDifferences {
  labels: [string, string];
  rows: LabelDifference[];
  count: number;
  compared: number;
  findings: string[];
}

/** A label that differs in two sets. */
export interface LabelDifference {
  /** With the variant, if there is one. */
  name: string;
  /** Its name alone. */
  label: string;
  kind: string;
  unit: string;
  function: string;
  /** The set that has it alone. */
  only: "" | "first" | "second";
  /** Largest difference of values. */
  largest: number | null;
  /** Number of values that differ, of `total`. */
  differ: number;
  total: number;
  /** Of the largest difference. */
  place: string;
  aspects: AspectRow[];
  /** True if the project can take the values of the second set. */
  takeable: boolean;
}

/** One aspect in which a label differs, in words. */
export interface AspectRow {
  aspect: string;
  first: string;
  second: string;
  place: string;
}

/** A label of two sets. */
export interface AskedPair {
  first: SourceName;
  second: SourceName;
  name: string;
}

/** A label in two sets; null for a set without it. */
export interface LabelPair {
  name: string;
  first: LabelValues | null;
  second: LabelValues | null;
}

/** The values of a label in C order, with its axes; a text has none. */
export interface LabelValues {
  kind: string;
  unit: string;
  description: string;
  function: string;
  axes: AxisPoints[];
  values: (number | null)[];
  text: string;
}

/** A file of the folder that is written; its ending selects the format. */
export interface WriteCommand {
  /** The set that is written. */
  first: SourceName;
  /** Name of the file. */
  target: string;
  /** A set whose labels replace those of the first. */
  second?: SourceName | null;
  /** These of its labels; null for all. */
  names?: string[] | null;
  /** The image whose copy gets the values. */
  image?: string;
  /** The A2L file of the image. */
  a2l?: string;
  /** Replace a file that exists. */
  force?: boolean;
}

/** A file that was written, and what differs from the first set. */
export interface WrittenCalibration {
  file: string;
  changes: LabelChange[];
  findings: string[];
  rounded: RoundedRow[];
}

/** A label of the second set that was replaced or added. */
export interface LabelChange {
  name: string;
  action: string;
  details: string;
}

/** An edit of values of a parameter. */
export interface ValueEdit {
  /** The parameter. */
  name: string;
  /** Numbers of the values in C order. */
  cells: number[];
  /** What is done, for the history. */
  title: string;
  /** Set the values, add an amount to them, or multiply them by it. */
  kind?: "set" | "add" | "scale";
  /** The values that are set. */
  values?: number[];
  /** What is added, or the factor. */
  amount?: number;
  /** Edits of one drag are one entry of the history; of those that wait, the last one counts. */
  drag?: string;
}

/** The set to compare with; null takes the last run, or the start. */
export interface ChosenReference {
  source?: SourceName | null;
}

/** Values of a parameter that are locked or pinned, or not any more, by their numbers in C order. */
export interface CellMark {
  name: string;
  cells: number[];
  on: boolean;
  title: string;
}

/** Keys of the project file with their new values. Edits of one `drag` are one entry of the history. */
export interface KeysEdit {
  changes: [Path, Toml | null][];
  title: string;
  drag?: string;
}

/** A key of the project file, and its value as TOML; an empty text removes the key. */
export interface TomlEdit {
  path: Path;
  text: string;
  title: string;
}

/** The fix that a user takes: the text of its finding, its title, and the chosen value. */
export interface ChosenFix {
  finding: string;
  fix: string;
  option?: string;
}

/** The text of the function, or of the project file if `file` is empty. */
export interface TextEdit {
  file: string;
  text: string;
  title: string;
  drag?: string;
}

/** A file of the folder that becomes the function. */
export interface ChosenFunction {
  file: string;
}

/** Name and text of new formula text; empty ones are chosen. */
export interface NewFormula {
  name?: string;
  text?: string;
}

/** The file of new formula text. */
export interface WrittenFormula {
  file: string;
}

/** Digests of files whose code may run, and of addresses that may be read. */
export interface AllowedCode {
  digests: string[];
}

/** Files of the folder. */
export interface FunctionsCommand {
  files: string[];
}

/** The names by which formula text calls the functions of files. */
export interface FunctionNames {
  names: string[];
}

/** A surrogate of a channel by others; `kind` is dynamic or static. */
export interface NewSurrogate {
  name: string;
  inputs: string[];
  output: string;
  kind?: string;
}

/** The training file that was written. */
export interface WrittenTraining {
  file: string;
}

/** A training file beside the project. */
export interface TrainCommand {
  file: string;
}

/** With `force`, files that another program has changed are replaced. */
export interface SaveCommand {
  force?: boolean;
}

/** Files that another program has changed, if there are any; nothing was written then. */
export interface SaveReply {
  conflicts?: Conflict[];
}

/** A file that another program has changed: its name, its text on disk, and that of the session, if it has one. */
export interface Conflict {
  file: string;
  disk: string;
  own: string;
}

/** With `discard`, the edits are forgotten. */
export interface RecoverCommand {
  discard?: boolean;
}

/** The title of the command that was taken back or done again; empty if there is none. */
export interface HistoryStep {
  title: string;
}

/** A calibration from the present values. */
export interface RunCommand {
  /** Continue an interrupted run from its checkpoints. */
  resume?: boolean;
  /** Number of processes for several starts. */
  workers?: number | null;
  /** Cross-validate with this number of parts of the data instead. */
  folds?: number | null;
  /** Kind of the parts. */
  parts?: string;
  /** Fit these values alone, with all others held. */
  only?: FittedPart | null;
}

/** Values of one table that are fitted alone. */
export interface FittedPart {
  /** The table. */
  name: string;
  /** Numbers of the values in C order. */
  cells: number[];
  /** What they are, for the history: `MapX at 3000, 40`. */
  title: string;
}

/** Values of a set that are taken, see `AskedChoice`. */
export interface AcceptedChoice {
  source: SourceName;
  cells: Record<string, number[] | null>;
  title: string;
}

/** Proposals that are added, by title, with what was chosen for those that have a choice. */
export interface AddedProposals {
  titles: string[];
  choices: Record<string, string>;
}

/** The state of the project after proposals were added. */
export interface AddedReply {
  /** Error of the first criterion on training data; null if the project still lacks something. */
  rmse: number | null;
  /** Of the error. */
  unit: string;
  /** What it lacks. */
  problems: string[];
}

/** Files of the folder. */
export interface AddedFiles {
  files: string[];
}

/** The role of each file in the project. */
export interface FileKinds {
  kinds: Record<string, string>;
}

/** Labels of a set whose values the project takes. */
export interface TakeCommand {
  source: SourceName;
  names: string[];
}

/** Number of parameters whose values were taken, and remarks. */
export interface TakenValues {
  taken: number;
  findings: string[];
}

/** Steps of parameters, null to remove one; the A2L file, empty to remove it, null to leave it as it is. */
export interface StorageEdit {
  steps: Record<string, number | null>;
  storage?: string | null;
}

/** The question of a design; what is null is chosen from the data. */
export interface DesignQuestion {
  points?: number | null;
  segments?: number | null;
  /** Find recordings that add nothing. */
  reduce?: boolean;
  /** With `reduce`: recordings that are kept. */
  keep?: number | null;
  /** Recordings or points to choose from, paths or patterns. */
  candidates?: string[];
  /** Parameters that points should determine. */
  names?: string[];
  /** Number of the direction that points should determine, from 1. */
  direction?: number | null;
}

/** The scope of a search; null for all. */
export interface TermQuestion {
  channels?: string[] | null;
  nodes?: string[] | null;
  kinds?: ("add" | "multiply" | "map" | "lag" | "delay" | "offset")[] | null;
  /** Effect that a proposal must explain on held-out data, in the unit of the target. */
  least?: number;
}

/** The title of the command that applied a term. */
export interface AppliedTerm {
  title: string;
}

/** Recent projects, the demos, the folder in which new projects are made, and the version of Kennfeld. */
export interface KnownProjects {
  recent: RecentRow[];
  demos: DemoRow[];
  folder: string;
  version: string;
}

/** A project that was opened before; the summary that follows `open` may lack any of its parts. */
export interface RecentRow {
  /** By which addresses of the page name it. */
  id: string;
  path: string;
  name: string;
  folder: string;
  /** When, in s since 1970; 0 if unknown. */
  opened: number;
  /** True if it has unsaved edits. */
  unsaved: boolean;
  /** True if it is open in this or in another page. */
  open: boolean;
  /** Status of the last run, or the number of problems. */
  state?: string;
  /** The first problem. */
  problem?: string;
  /** Formula file. */
  file?: string;
  /** Of the first criterion. */
  node?: string;
  unit?: string;
  /** RMSE on training data. */
  training?: number;
  /** RMSE on test data. */
  test?: number;
  /** Of the errors on training data. */
  histogram?: number[];
  /** Number of nodes. */
  nodes?: number;
  /** Name, use and samples of each. */
  datasets?: [string, string, number][];
  /** Number of free parameters. */
  parameters?: number;
  /** Number of free values. */
  values?: number;
  /** The last run in words. */
  run?: string;
  withoutData?: number;
  picture?: PictureLines;
}

/** Measured, present and initial values of the first criterion over the first dataset, thinned out. */
export interface PictureLines {
  dataset: string;
  timed: boolean;
  x: (number | null)[];
  measured: (number | null)[];
  now: (number | null)[];
  start: (number | null)[];
}

/** A demo that can be written. */
export interface DemoRow {
  name: string;
  title: string;
  text: string;
  facts: string;
}

/** A project by its file or folder. */
export interface ProjectPath {
  path: string;
}

/** A project that was opened before, by its id. */
export interface ProjectId {
  project: string;
}

/** A demo by its name. */
export interface DemoName {
  name: string;
}

/** A new project. */
export interface NewProject {
  /** Of its folder. */
  name: string;
  /** The name is that of a file that was dropped, and a number is added if the folder exists. */
  free?: boolean;
}

/** The state, as sent to all pages after every change. */
export interface StateNews {
  state: AppState | NoProject;
}

/** The open project as all pages show it; numbers follow once it can be evaluated. */
export interface AppState {
  project: OpenProject;
  /** Changes with what the model shows, not with the progress of a run. */
  revision: number;
  /** Changes with the project file and the function. */
  textRevision: number;
  unsaved: string[];
  undo: string;
  redo: string;
  findings: FindingRow[];
  code: UndecidedCode[];
  job: JobState;
  /** Titles of edits that wait for the end of the run. */
  waiting: string[];
  training: TrainingState;
  terms: SearchState;
  design: SearchState;
  runs: RunRow[];
  seconds: number;
  /** Files of the project that another program has changed, each with how. */
  changedOnDisk: string[];
  recoverable: boolean;
  /** The user has stopped the reading of the recordings, which are missing. */
  interrupted: boolean;
  function: ShownFunction;
  nodes?: NamedUnit[];
  inputs?: string[];
  scores?: ScoreRow[];
  parameters?: ParameterRow[];
  freeValues?: number;
  datasets?: DatasetRow[];
  criteria?: CriterionRow[];
  /** Of data in partitions: samples that the screens show, and all samples; null if all are shown. */
  excerpt?: [number, number] | null;
  reference?: ReferenceRow;
}

/** The open project. */
export interface OpenProject {
  /** By which addresses of the page name it, and by which answers say what they are about. */
  id: string;
  /** As the project file says it. */
  name: string;
  /** The project file. */
  path: string;
}

/** A message about the project. */
export interface FindingRow {
  severity: "error" | "warning" | "remark";
  /** The message with its location. */
  text: string;
  /** The message alone. */
  message: string;
  file: string;
  line: number;
  column: number;
  /** Place within the file: `[model] step`. */
  path: string;
  /** The screen on which it is solved. */
  screen: "data" | "function" | "parameters" | "optimization" | "results" | "design";
  /** Changes of the project file that solve it. */
  fixes: FixRow[];
}

/** A fix of a finding by its title, and the values to choose from if it needs one. */
export interface FixRow {
  title: string;
  options: string[];
}

/** A file whose code, or an address that, has not been allowed. */
export interface UndecidedCode {
  file: string;
  digest: string;
  text: string;
}

/** The running or last calibration, or cross-validation if it `validates`. */
export interface JobState {
  state: string;
  message: string;
  seconds: number;
  run: number;
  iterations: number;
  validates: boolean;
}

/** The running or last training of a surrogate: idle, running, trained, failed or stopped. */
export interface TrainingState {
  state: string;
  file: string;
  seconds: number;
  lines: string[];
}

/** The running or last search beside the calibration: idle, running, ended, failed or stopped. */
export interface SearchState {
  state: string;
  /** What it does; why it failed. */
  text: string;
  /** Parts that are done, of `parts`; 0 if their number is not known. */
  done: number;
  parts: number;
  seconds: number;
  /** What it has found, in a few words. */
  detail: string;
}

/** A calibration of this session; `part` are the values that it fitted, in words, empty if all. */
export interface RunRow {
  number: number;
  status: string;
  part: string;
}

/** The file of the function, and the screen that shows it: `formula`, or the one of its importer. */
export interface ShownFunction {
  file: string;
  screen: string;
}

/** Errors of a criterion over the datasets of a use: now, at the start, and before the last change. */
export interface ScoreRow {
  criterion: string;
  use: string;
  unit: string;
  samples: number;
  rmse: number | null;
  before: number | null;
  last: number | null;
  mean: number | null;
  largest: number | null;
}

/** A parameter of the function, with numbers of its values. */
export interface ParameterRow {
  name: string;
  kind: string;
  unit: string;
  description: string;
  shape: number[];
  free: boolean;
  changed: number;
  atBound: number;
  withoutData: number;
  /** Largest change against the reference, relative to the largest value. */
  change: number | null;
  /**
   * Median standard deviation after the last run, relative to the span of the values; null if it is not known, or if
   * most values are undetermined, which `undetermined` says.
   */
  deviation: number | null;
  undetermined: boolean;
  /** True if no criterion depends on it, or no training sample looks it up. */
  unused: boolean;
  thumbnail: number[][];
}

/** A dataset. */
export interface DatasetRow {
  /** In the project file, from 1 on; those that are off count there. */
  number: number;
  name: string;
  use: string;
  samples: number;
  timed: boolean;
  begin: number;
  end: number;
  /** The positions at which its pieces but the first begin. */
  pieces: number[];
  channels: NamedUnit[];
}

/** A criterion: its node, and what that is to follow. */
export interface CriterionRow {
  node: string;
  target: string;
  unit: string;
}

/** The set that present values are compared with: "start", the number of a run or "file:NAME", and in words. */
export interface ReferenceRow {
  key: string;
  title: string;
  chosen: boolean;
}

/** The state without an open project. */
export interface NoProject {
  project: null;
}

/** An activity that takes a while, and the share of it that is done; an empty text at its end. */
export interface ActivityNews {
  text: string;
  share: number | null;
}

/** Questions by name: what is asked, and the JSON and the arrays of the reply. */
export interface Questions {
  table: { asks: AskedTable; head: TableReply; arrays: Nothing };
  strip: { asks: AskedStrip; head: StripReply; arrays: StripArrays };
  statistics: { asks: AskedStatistics; head: StatisticsReply; arrays: Nothing };
  cursor: { asks: AskedCursor; head: CursorReply; arrays: Nothing };
  scatter: { asks: AskedScatter; head: Nothing; arrays: ScatterArrays };
  points: { asks: AskedPoints; head: PointsReply; arrays: PointsArrays };
  signals: { asks: AskedSignals; head: SignalRows; arrays: Nothing };
  informing: { asks: AskedInforming; head: InformingReply; arrays: InformingArrays };
  passed: { asks: AskedPassed; head: PassedReply; arrays: PassedArrays };
  conditions: { asks: AskedConditions; head: BrushedConditions; arrays: Nothing };
  coverage: { asks: AskedCoverage; head: Nothing; arrays: CoverageArrays };
  split: { asks: AskedSplit; head: SplitError; arrays: Nothing };
  worst: { asks: AskedWorst; head: WorstSamples; arrays: Nothing };
  progress: { asks: Nothing; head: RunProgress; arrays: RunProgressArrays };
  outcome: { asks: Nothing; head: RunOutcome; arrays: Nothing };
  "by-file": { asks: Nothing; head: ErrorsByFile; arrays: Nothing };
  sets: { asks: Nothing; head: SetHistory; arrays: Nothing };
  compare: { asks: ComparedValues; head: ValueChanges; arrays: Nothing };
  choice: { asks: AskedChoice; head: ChoiceScores; arrays: Nothing };
  limits: { asks: ComparedValues; head: LimitRows; arrays: Nothing };
  trust: { asks: Nothing; head: TrustReply; arrays: Nothing };
  pinned: { asks: AskedPin; head: PinnedReply; arrays: Nothing };
  settings: { asks: Nothing; head: SettingsReply; arrays: Nothing };
  schema: { asks: Nothing; head: SchemaReply; arrays: Nothing };
  names: { asks: Nothing; head: NamesReply; arrays: Nothing };
  files: { asks: Nothing; head: DataFiles; arrays: Nothing };
  "file-errors": { asks: AskedErrors; head: FileErrors; arrays: FileErrorsArrays };
  "file-lines": { asks: AskedFileLines; head: FileLines; arrays: FileLinesArrays };
  "shift-scan": { asks: AskedScan; head: ScanReply; arrays: ScanArrays };
  proposals: { asks: Nothing; head: ProposalRows; arrays: Nothing };
  functions: { asks: Nothing; head: KnownFunctions; arrays: Nothing };
  diagram: { asks: Nothing; head: ImportedFunction; arrays: Nothing };
  program: { asks: Nothing; head: ImportedFunction; arrays: Nothing };
  spellings: { asks: Nothing; head: SpellingRows; arrays: Nothing };
  flow: { asks: Nothing; head: FunctionFlow; arrays: Nothing };
  parts: { asks: Nothing; head: ImportableParts; arrays: Nothing };
  "formula-reads": { asks: AskedFormula; head: FormulaReads; arrays: Nothing };
  "function-file": { asks: Nothing; head: ProjectFunction; arrays: Nothing };
  "called-functions": { asks: Nothing; head: CallableFunctions; arrays: Nothing };
  completions: { asks: Nothing; head: CompletionRows; arrays: Nothing };
  surrogates: { asks: Nothing; head: SurrogateRows; arrays: Nothing };
  validity: { asks: Nothing; head: ValidityRows; arrays: Nothing };
  formats: { asks: Nothing; head: ExportFormats; arrays: Nothing };
  export: { asks: ExportCommand; head: ExportedFiles | ExistingFile; arrays: Nothing };
  "open-file": { asks: OpenedFile; head: Nothing; arrays: Nothing };
  "control-unit": { asks: Nothing; head: ControlUnit; arrays: Nothing };
  rounding: { asks: AskedRounding; head: RoundingReply; arrays: Nothing };
  "finer-storage": { asks: AskedTrial; head: FinerRow; arrays: Nothing };
  code: { asks: AskedCode; head: CodeReply; arrays: Nothing };
  "write-unit": { asks: UnitCommand; head: WrittenUnit | ExistingFiles; arrays: Nothing };
  designs: { asks: Nothing; head: Designs; arrays: Nothing };
  "design-map": { asks: AskedMap; head: DesignMap; arrays: DesignMapArrays };
  "export-design": { asks: DesignExport; head: WrittenDesign | ExistingFiles; arrays: Nothing };
  missing: { asks: Nothing; head: MissingTerms; arrays: Nothing };
  term: { asks: AskedTerm; head: ShownTerm; arrays: ShownTermArrays };
  calibrations: { asks: Nothing; head: CalibrationFiles; arrays: Nothing };
  contents: { asks: AskedContents; head: SetContents; arrays: Nothing };
  differences: { asks: AskedDifferences; head: SetDifferences; arrays: Nothing };
  pair: { asks: AskedPair; head: LabelPair; arrays: Nothing };
  "write-calibration": { asks: WriteCommand; head: WrittenCalibration | ExistingFile; arrays: Nothing };
  "set-values": { asks: ValueEdit; head: Nothing; arrays: Nothing };
  "choose-reference": { asks: ChosenReference; head: Nothing; arrays: Nothing };
  "lock-values": { asks: CellMark; head: Nothing; arrays: Nothing };
  "pin-values": { asks: CellMark; head: Nothing; arrays: Nothing };
  "set-keys": { asks: KeysEdit; head: Nothing; arrays: Nothing };
  "set-toml": { asks: TomlEdit; head: Nothing; arrays: Nothing };
  "apply-fix": { asks: ChosenFix; head: Nothing; arrays: Nothing };
  "set-text": { asks: TextEdit; head: Nothing; arrays: Nothing };
  "choose-function": { asks: ChosenFunction; head: Nothing; arrays: Nothing };
  "reread-function": { asks: Nothing; head: Nothing; arrays: Nothing };
  "new-function": { asks: NewFormula; head: WrittenFormula; arrays: Nothing };
  "convert-function": { asks: Nothing; head: WrittenFormula; arrays: Nothing };
  "allow-code": { asks: AllowedCode; head: Nothing; arrays: Nothing };
  "add-functions": { asks: FunctionsCommand; head: FunctionNames; arrays: Nothing };
  "new-surrogate": { asks: NewSurrogate; head: WrittenTraining; arrays: Nothing };
  "train-surrogate": { asks: TrainCommand; head: Nothing; arrays: Nothing };
  "stop-training": { asks: Nothing; head: Nothing; arrays: Nothing };
  save: { asks: SaveCommand; head: SaveReply; arrays: Nothing };
  reload: { asks: Nothing; head: Nothing; arrays: Nothing };
  discard: { asks: Nothing; head: Nothing; arrays: Nothing };
  recover: { asks: RecoverCommand; head: Nothing; arrays: Nothing };
  undo: { asks: Nothing; head: HistoryStep; arrays: Nothing };
  redo: { asks: Nothing; head: HistoryStep; arrays: Nothing };
  run: { asks: RunCommand; head: Nothing; arrays: Nothing };
  stop: { asks: Nothing; head: Nothing; arrays: Nothing };
  accept: { asks: AcceptedChoice; head: Nothing; arrays: Nothing };
  "add-proposals": { asks: AddedProposals; head: AddedReply; arrays: Nothing };
  "add-files": { asks: AddedFiles; head: FileKinds; arrays: Nothing };
  "take-values": { asks: TakeCommand; head: TakenValues; arrays: Nothing };
  "set-storage": { asks: StorageEdit; head: Nothing; arrays: Nothing };
  "propose-design": { asks: DesignQuestion; head: Nothing; arrays: Nothing };
  "stop-design": { asks: Nothing; head: Nothing; arrays: Nothing };
  look: { asks: TermQuestion; head: Nothing; arrays: Nothing };
  "stop-looking": { asks: Nothing; head: Nothing; arrays: Nothing };
  "apply-term": { asks: AskedTerm; head: AppliedTerm; arrays: Nothing };
  projects: { asks: Nothing; head: KnownProjects; arrays: Nothing };
  open: { asks: ProjectPath; head: Nothing; arrays: Nothing };
  show: { asks: ProjectId; head: Nothing; arrays: Nothing };
  demo: { asks: DemoName; head: Nothing; arrays: Nothing };
  new: { asks: NewProject; head: Nothing; arrays: Nothing };
  forget: { asks: ProjectPath; head: Nothing; arrays: Nothing };
}
