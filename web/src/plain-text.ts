// Texts of the page as other programs take them: cells of spreadsheets, names of files.

/** A text of the page as a spreadsheet reads it. */
export function plainText(text: string): string {
  const line = text.replace(/\s*\n\s*/g, " ").trim();
  if (line === "–") return "";
  const number = line.replace(/^\u2212/, "-").replace(/\u2009/g, "");
  return /^[+-]?[\d.]+(e[+-]?\d+)?$/i.test(number) ? number : line.replaceAll("\t", " ");
}

/** A name of a file: the project, and what it shows. */
export const fileName = (project: string, label: string, ending: string): string =>
  `${
    [project, label]
      .map((text) => text.replace(/[^\p{L}\p{N}.-]+/gu, "-").replace(/^[-.]+|[-.]+$/g, ""))
      .filter(Boolean)
      .join("-")
      .slice(0, 80) || "kennfeld"
  }.${ending}`;
