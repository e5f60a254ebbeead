// Files of other tools that hold functions: FMUs, ONNX networks, C and Python.

export const FUNCTION_FILES = ".fmu,.onnx,.c,.py";
const KNOWN = /\.(fmu|onnx|c|py)$/i;

/** True if a file of this name holds functions. */
export const holdsFunctions = (name: string): boolean => KNOWN.test(name);

/** True if a file of this name may be a part of a function in C. */
export const isHeader = (name: string): boolean => /\.h$/i.test(name);

/** A file without the name of its function: `engine.c` of `engine.c:lag`. */
export const fileOf = (reference: string): string => /^(.*\.(?:fmu|onnx|c|py)):\w+$/i.exec(reference)?.[1] ?? reference;
