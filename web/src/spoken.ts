// Dates as one says them.

/** The time of day: 16:52. */
export const clock = (seconds: number): string => {
  const then = new Date(seconds * 1000);
  return `${String(then.getHours()).padStart(2, "0")}:${String(then.getMinutes()).padStart(2, "0")}`;
};
