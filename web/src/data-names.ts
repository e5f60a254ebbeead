// Names of files where there is little room.

/** What tells the name of a file from those of the others, without its ending: `01` of `bench_01.csv`. */
export function distinctNames(names: string[]): string[] {
  const stems = names.map((name) => name.replace(/\.\w+$/, ""));
  return stems.map((stem) => {
    const ends = /^(.*[^\p{L}\p{N}])([\p{L}\p{N}]+)$/u.exec(stem);
    const shared = ends !== null && stems.filter((each) => each.startsWith(ends[1]!)).length > 1;
    return shared ? ends[2]! : stem;
  });
}
