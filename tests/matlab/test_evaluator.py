"""The values of expressions, worked out by hand from the rules of the language."""

import contextlib
import math
import re

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kennfeld.matlab.errors import Budget, MatlabError
from kennfeld.matlab.evaluator import evaluate
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.values import MatlabCell, MatlabStruct, class_name, text
from kennfeld.program.traversal import names_read
from tests.draws import few_or_many

nan, inf = math.nan, math.inf
VARIABLES = {
    "x": np.array([1.0, 2.0, 3.0]),
    "A": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
    "B": np.arange(1.0, 25.0).reshape((2, 3, 4), order="F"),
    "K": 2,
    "on": True,
    "s": {"a": 1, "b": {"c": [1, "hi", np.array([4.0, 5.0])]}},
    "word": "torque",
    "c": [10, "ten", np.array([1.0, 2.0])],
    "u8": np.array([200, 100], dtype=np.uint8),
}

NUMBERS = {
    # operators
    "1 + 2*3": 7,
    "(1 + 2)*3": 9,
    "-2^2": -4,
    "2^-1": 0.5,
    "2^3^2": 64,
    "6/3/2": 1,
    "2\\6": 3,
    "-K": -2,
    "~0": True,
    "~on": False,
    "!on": False,
    "K == 2": True,
    "K ~= 2": False,
    "1:3 == [1 5 3]": [[True, False, True]],
    "x .* x": [[1, 4, 9]],
    "x ./ [2 4 6]": [[0.5, 0.5, 0.5]],
    "x .^ 2": [[1, 4, 9]],
    "2 .^ x": [[2, 4, 8]],
    "x * 2": [[2, 4, 6]],
    "x * x'": 14,
    "x' * x": [[1, 2, 3], [2, 4, 6], [3, 6, 9]],
    "A * [1; 0; 1]": [[4], [10]],
    "[2 0; 0 4] \\ [2; 4]": [[1], [1]],
    "[2 4] / [2 0; 0 4]": [[1, 1]],
    "[1 1; 0 1]^3": [[1, 3], [0, 1]],
    "x + [10; 20]": [[11, 12, 13], [21, 22, 23]],
    "A - [1; 4]": [[0, 1, 2], [0, 1, 2]],
    "1/0": inf,
    "-1/0": -inf,
    "0/0": nan,
    "5 > 3 & 2 > 1": True,
    "1 | 0": True,
    "0 || 1": True,
    "0 && undefined_name": False,
    "1 || undefined_name": True,
    "[] == []": np.zeros((0, 0)),
    "'abc' == 'abd'": [[True, True, False]],
    "'a' + 1": 98,
    "true + true": 2,
    "3i == 3": None,
    # matrices
    "[1 -2]": [[1, -2]],
    "[1 - 2]": -1,
    "[1 , 2\n 3 , 4]": [[1, 2], [3, 4]],
    "[x; x*2]": [[1, 2, 3], [2, 4, 6]],
    "[x', x']": [[1, 1], [2, 2], [3, 3]],
    "[[] 1 []]": 1,
    "[0 cumsum(x)]": [[0, 1, 3, 6]],
    "[x(1:2) 9]": [[1, 2, 9]],
    "[true 2]": [[1, 2]],
    "[c{1} 5]": [[10, 5]],
    "[]": np.zeros((0, 0)),
    "{}": None,
    # ranges
    "1:4": [[1, 2, 3, 4]],
    "0:0.25:1": [[0, 0.25, 0.5, 0.75, 1]],
    "5:-2:0": [[5, 3, 1]],
    "1:0": np.zeros((1, 0)),
    "numel(0:0.1:1)": 11,
    "max(0:0.1:0.3)": 0.3,
    "numel(0:0.01:10)": 1001,
    "-(1:3)": [[-1, -2, -3]],
    # indices
    "x(2)": 2,
    "x(end)": 3,
    "x(end-1)": 2,
    "x([1 3])": [[1, 3]],
    "x(:)": [[1], [2], [3]],
    "x(logical([1 0 1]))": [[1, 3]],
    "x(x > 1)": [[2, 3]],
    "x([])": np.zeros((0, 0)),
    "x([1 2; 3 1])": [[1, 2], [3, 1]],
    "A(2, 3)": 6,
    "A(:, 2)": [[2], [5]],
    "A(1, :)": [[1, 2, 3]],
    "A(end, end)": 6,
    "A(end)": 6,
    "A(3)": 2,
    "A(:)'": [[1, 4, 2, 5, 3, 6]],
    "A(A > 2)'": [[4, 5, 3, 6]],
    "A([2 1], [1 3])": [[4, 6], [1, 3]],
    "A(:, end+1-1)": [[3], [6]],
    "A(:, [true false true])": [[1, 3], [4, 6]],
    "B(2, 3, 4)": 24,
    "B(2, 12)": 24,
    "B(:, :, 2)": [[7, 9, 11], [8, 10, 12]],
    "size(B(:, 1, :))": [[2, 1, 4]],
    "B(1, end)": 23,
    "A(min(end, 5))": 3,
    "A'": [[1, 4], [2, 5], [3, 6]],
    "s.a": 1,
    "s.b.c{1}": 1,
    "s.b.c{3}(2)": 5,
    "s.('a')": 1,
    "c{3}(end)": 2,
    "numel(c(1:2))": 2,
    # sizes and shapes
    "size(A)": [[2, 3]],
    "size(A([true false true]))": [[1, 2]],
    "size(A([true; false; true]))": [[2, 1]],
    "size(A, 1)": 2,
    "size(B)": [[2, 3, 4]],
    "size(5)": [[1, 1]],
    "numel(A)": 6,
    "length(A)": 3,
    "length([])": 0,
    "ndims(B)": 3,
    "isempty([])": True,
    "isempty('')": True,
    "isscalar(K)": True,
    "isvector(x)": True,
    "isrow(x)": True,
    "iscolumn(x)": False,
    "zeros(2)": [[0, 0], [0, 0]],
    "zeros(1, 3)": [[0, 0, 0]],
    "ones(2, 1)": [[1], [1]],
    "zeros(size(x))": [[0, 0, 0]],
    "eye(2)": [[1, 0], [0, 1]],
    "eye(2, 3)": [[1, 0, 0], [0, 1, 0]],
    "NaN(1, 2)": [[nan, nan]],
    "Inf": inf,
    "pi": math.pi,
    "eps": 2.0**-52,
    "linspace(0, 1, 5)": [[0, 0.25, 0.5, 0.75, 1]],
    "logspace(0, 2, 3)": [[1, 10, 100]],
    "repmat([1 2], 2, 2)": [[1, 2, 1, 2], [1, 2, 1, 2]],
    "repmat(7, [1 3])": [[7, 7, 7]],
    "reshape(1:6, 2, 3)": [[1, 3, 5], [2, 4, 6]],
    "reshape(1:6, [], 2)": [[1, 4], [2, 5], [3, 6]],
    "reshape(1:4, [2 2])": [[1, 3], [2, 4]],
    "fliplr(x)": [[3, 2, 1]],
    "flipud(A)": [[4, 5, 6], [1, 2, 3]],
    "flip(x)": [[3, 2, 1]],
    "rot90([1 2; 3 4])": [[2, 4], [1, 3]],
    "circshift(1:4, 1)": [[4, 1, 2, 3]],
    "diag([1 2])": [[1, 0], [0, 2]],
    "diag([1 2; 3 4])": [[1], [4]],
    "tril([1 2; 3 4])": [[1, 0], [3, 4]],
    "triu([1 2; 3 4])": [[1, 2], [0, 4]],
    "kron([1 2], [1; 1])": [[1, 2], [1, 2]],
    "permute(reshape(1:6, 1, 2, 3), [3 2 1])": [[1, 2], [3, 4], [5, 6]],
    "squeeze(B(1, 2, :))'": [[3, 9, 15, 21]],
    "horzcat(x, 4)": [[1, 2, 3, 4]],
    "vertcat(1, 2)": [[1], [2]],
    "size(cat(3, A, A))": [[2, 3, 2]],
    "meshgrid(1:3, 1:2)": [[1, 2, 3], [1, 2, 3]],
    "ndgrid(1:2, 1:3)": [[1, 1, 1], [2, 2, 2]],
    "sub2ind([2 3], 2, 3)": 6,
    "ind2sub([2 3], 6)": 6,
    "colon(1, 3)": [[1, 2, 3]],
    # sums
    "sum(x)": 6,
    "sum(A)": [[5, 7, 9]],
    "sum(A, 2)": [[6], [15]],
    "sum(A(:))": 21,
    "sum(A, 'all')": 21,
    "sum([])": 0,
    "prod(x)": 6,
    "prod([])": 1,
    "mean(A)": [[2.5, 3.5, 4.5]],
    "mean(x)": 2,
    "median([3 1 2])": 2,
    "std([1 2 3 4])": math.sqrt(5 / 3),
    "var([1 2 3 4], 1)": 1.25,
    "cumsum(A, 2)": [[1, 3, 6], [4, 9, 15]],
    "cumsum(A)": [[1, 2, 3], [5, 7, 9]],
    "cumprod(x)": [[1, 2, 6]],
    "diff([1 4 9])": [[3, 5]],
    "diff(A)": [[3, 3, 3]],
    "diff([1 4 9], 2)": 2,
    "min(x)": 1,
    "max(A)": [[4, 5, 6]],
    "max(A, [], 2)": [[3], [6]],
    "max(A(:))": 6,
    "max(x, 2)": [[2, 2, 3]],
    "min([1 NaN 0])": 0,
    "max([])": np.zeros((0, 0)),
    "max(3, [])": np.zeros((0, 0)),
    "any([0 0 1])": True,
    "all([1 1 0])": False,
    "any(A > 5)": [[False, False, True]],
    "all([])": True,
    "nnz([1 0 2])": 2,
    "dot([1 2 3], [4 5 6])": 32,
    "cross([1 0 0], [0 1 0])": [[0, 0, 1]],
    "norm([3 4])": 5,
    "norm([1 -2], inf)": 2,
    "trapz([0 1 2], [0 1 0])": 1,
    "trapz([1 2 3])": 4,
    "cumtrapz([0 1 2])": [[0, 0.5, 2]],
    "det([1 2; 3 4])": -2,
    "inv([2 0; 0 4])": [[0.5, 0], [0, 0.25]],
    "trace([1 2; 3 4])": 5,
    # elements
    "abs([-1 2])": [[1, 2]],
    "sign([-3 0 2])": [[-1, 0, 1]],
    "floor(-1.5)": -2,
    "ceil(-1.5)": -1,
    "fix(-1.5)": -1,
    "round([2.5 -2.5 0.4])": [[3, -3, 0]],
    "round(3.14159, 2)": 3.14,
    "mod(-1, 3)": 2,
    "mod(5, 0)": 5,
    "mod(5.5, 2)": 1.5,
    "mod(-1, -3)": -1,
    "rem(-1, 3)": -1,
    "rem(5, 3)": 2,
    "sqrt(16)": 4,
    "exp(0)": 1,
    "log(exp(1))": 1,
    "log2(8)": 3,
    "log10(1000)": 3,
    "power(2, 3)": 8,
    "hypot(3, 4)": 5,
    "atan2(1, 1)": math.pi / 4,
    "sind(30)": 0.5,
    "cosd(90)": 0,
    "tand(45)": 1,
    "deg2rad(180)": math.pi,
    "factorial([3 0])": [[6, 1]],
    "gamma(5)": 24,
    "nchoosek(5, 2)": 10,
    "gcd(12, 18)": 6,
    "lcm(4, 6)": 12,
    "primes(10)": [[2, 3, 5, 7]],
    "isnan([1 NaN])": [[False, True]],
    "isfinite([1 Inf])": [[True, False]],
    "isinf(-Inf)": True,
    "bitand(12, 10)": 8,
    "bitor(12, 10)": 14,
    "bitxor(12, 10)": 6,
    "bitshift(1, 4)": 16,
    "bitshift(16, -2)": 4,
    "bitget(5, 1:3)": [[1, 0, 1]],
    "xor(true, false)": True,
    "not(1)": False,
    "nextpow2(100)": 7,
    # tables and polynomials
    "polyval([1 2 3], 2)": 11,
    "polyval([1 0], [1 2])": [[1, 2]],
    "polyfit([0 1 2], [1 3 5], 1)": [[2, 1]],
    "polyder([1 2 3])": [[2, 2]],
    "conv([1 1], [1 -1])": [[1, 0, -1]],
    "roots([1 -3 2])": [[2], [1]],
    "interp1([1 2 3], [10 20 30], 2.5)": 25,
    "interp1([1 2 3], [10 20 30], [0 3])": [[nan, 30]],
    "interp1([1 2 3], [10 20 30], 4, 'linear', 'extrap')": 40,
    "interp1([1 2 3], [10 20 30], 0, 'linear', -1)": -1,
    "interp1([1 2 3], [10 20 30], 1.6, 'nearest')": 20,
    "interp1([1 2 3], [10 20 30], 1.9, 'previous')": 10,
    "interp1([1 2 3], [10 20 30], 1.1, 'next')": 20,
    "interp1([10 20 30], 1.5)": 15,
    "interp1([3 1 2], [30 10 20], 2.5)": 25,
    "interp1([0 1 2 3], [0 1 8 27], 1.5, 'spline')": 3.375,
    "interp1([1;2], [1 10; 2 20], 1.5)": [[1.5, 15]],
    "interp2([1 2], [10 20], [1 2; 3 4], 1.5, 15)": 2.5,
    "interp2([1 2], [10 20], [1 2; 3 4], 3, 15)": nan,
    "interp2([1 2; 3 4], 1, 2)": 3,
    "size(string([1 2 3; 4 5 6]))": [[2, 3]],
    "filter(1, [1 -0.5], [1 0 0])": [[1, 0.5, 0.25]],
    # finding
    "find([0 1 1])": [[2, 3]],
    "find([0; 1; 1])": [[2], [3]],
    "find(x > 1, 1)": 2,
    "find(A == 5)": 4,
    "find([0 0])": np.zeros((1, 0)),
    "sort([3 1 2])": [[1, 2, 3]],
    "sort([3 1 2], 'descend')": [[3, 2, 1]],
    "sort([2 NaN 1])": [[1, 2, nan]],
    "sort([2 NaN 1], 'descend')": [[nan, 2, 1]],
    "sort([3 1; 2 4], 2)": [[1, 3], [2, 4]],
    "unique([3 1 1 2])": [[1, 2, 3]],
    "unique([3 1 3], 'stable')": [[3, 1]],
    "ismember(2, x)": True,
    "ismember([1 9], x)": [[True, False]],
    "ismember('a', {'a', 'b'})": True,
    "union([1 3], [2 3])": [[1, 2, 3]],
    "intersect([1 2 3], [2 3 4])": [[2, 3]],
    "setdiff([1 2 3], 2)": [[1, 3]],
    "issorted([1 2 2])": True,
    "isequal(x, [1 2 3])": True,
    "isequal('a', 'b')": False,
    "isequal(struct('a', 1), struct('a', 1))": True,
    "histc([1 2 2 5], [1 2 5])": [[1, 2, 1]],
    # classes
    "int8(200)": 127,
    "uint8(-5)": 0,
    "uint8(2.5)": 3,
    "int16(-2.5)": -3,
    "int8(100) + int8(100)": 127,
    "uint8(3) / uint8(2)": 2,
    "uint8(250) + 10.4": 255,
    "u8 * 2": [[255, 200]],
    "5 - uint8(7)": 0,
    "uint8([1 2]) .* [1.5 1.5]": [[2, 3]],
    "uint8(NaN)": 0,
    "int64(9007199254740993)": 9007199254740992,
    "double(int8(5)) / 2": 2.5,
    "double('A')": 65,
    "logical([2 0])": [[True, False]],
    "single(0.1) == 0.1": False,
    "0xFF": 255,
    "intmax('uint8')": 255,
    "intmin('int8')": -128,
    "realmax": np.finfo(float).max,
    "isnumeric(int8(1))": True,
    "isnumeric('a')": False,
    "ischar(word)": True,
    "iscell(c)": True,
    "isstruct(s)": True,
    "islogical(on)": True,
    "isa(5, 'float')": True,
    "isreal(5)": True,
    "exist('K', 'var')": 1,
    "exist('nothing_here')": 0,
    # texts
    "strcmp('a', 'a')": True,
    "strcmp('a', {'a', 'b'})": [[True, False]],
    "strcmpi('A', 'a')": True,
    "strncmp('abc', 'abd', 2)": True,
    "str2double('3.5')": 3.5,
    "str2double('x')": nan,
    "strfind('abab', 'ab')": [[1, 3]],
    "contains('torque', 'orq')": True,
    "startsWith('torque', 'to')": True,
    "endsWith('torque', 'ue')": True,
    "length('torque')": 6,
    "word(end) == 'e'": True,
    "bin2dec('101')": 5,
    "hex2dec('FF')": 255,
    "numel(strsplit('a,b,c', ','))": 3,
    '"a" == "a"': True,
    # structs, cells, functions
    "isfield(s, 'a')": True,
    "isfield(s, {'a', 'z'})": [[True, False]],
    "numel(fieldnames(s))": 2,
    "struct('a', 5).a": 5,
    "numel(struct('a', {1, 2, 3}))": 3,
    "[struct('a', {1, 2, 3}).a]": [[1, 2, 3]],
    "numel([struct('a', 1), struct('a', {2, 3}), []])": 3,
    "size([struct('a', 1); struct('a', 2)])": [[2, 1]],
    "[[struct('a', 1, 'b', 2), struct('b', 4, 'a', 3)].a]": [[1, 3]],
    "getfield(s, 'a')": 1,
    "numel(cell(2, 3))": 6,
    "cell2mat({1 2; 3 4})": [[1, 2], [3, 4]],
    "cellfun(@numel, {1, [1 2], []})": [[1, 2, 0]],
    "cellfun(@(a) a*K, {1, 2})": [[2, 4]],
    "cellfun('isempty', {1, []})": [[False, True]],
    "arrayfun(@(a) a^2, x)": [[1, 4, 9]],
    "feval(@plus, 1, 2)": 3,
    "feval(@(a, b) a - b, 5, 2)": 3,
    "Simulink.Parameter(5).Value": 5,
    "Simulink.Parameter(5) * 2": 10,
    "[Simulink.Parameter(5) 1]": [[5, 1]],
}
TEXTS = {
    "'it''s'": "it's",
    "['ab' 'cd']": "abcd",
    "[65 'b']": "Ab",
    "word(1:3)": "tor",
    "word(end:-1:1)": "euqrot",
    "upper('aB')": "AB",
    "lower('aB')": "ab",
    "strtrim('  a ')": "a",
    "strrep('abab', 'b', 'xy')": "axyaxy",
    "strcat('a', 'b ', 'c')": "abc",
    "strjoin({'a', 'b'}, '-')": "a-b",
    "num2str(3)": "3",
    "num2str(pi)": "3.1416",
    "num2str(pi, 8)": "3.1415927",
    "num2str([1 2 3])": "1  2  3",
    "num2str(1.5, '%05.2f')": "01.50",
    "num2str(true)": "1",
    "int2str(2.6)": "3",
    "mat2str([1 2; 3 4.5])": "[1 2;3 4.5]",
    "mat2str([true false])": "[true false]",
    "sprintf('%d %s', 3, 'x')": "3 x",
    "sprintf('%d,', [1 2 3])": "1,2,3,",
    "sprintf('%5.2f|', pi)": " 3.14|",
    "sprintf('%g', 0.5)": "0.5",
    "sprintf('%d', 1.5)": "1.500000e+00",
    "sprintf('100%%')": "100%",
    "sprintf('a\\n')": "a\n",
    "sprintf('%x', 255)": "ff",
    "class(1)": "double",
    "class('a')": "char",
    "class(on)": "logical",
    "class(single(1) + 1)": "single",
    "class(int8(1) + 1)": "int8",
    "class(A > 1)": "logical",
    "class({})": "cell",
    "class(@sin)": "function_handle",
    'class("a")': "string",
    'upper("a") + "b"': "Ab",
    'string(2.5) + "b"': "2.5b",
    "class(Simulink.Parameter)": "Simulink.Parameter",
    "c{2}": "ten",
    "s.b.c{2}": "hi",
    "char([72 105])": "Hi",
    "char({'a'})": "a",
    "dec2bin(5)": "101",
    "dec2hex(255)": "FF",
    "func2str(@(a) a + 1)": "@(a)a + 1",
    "blanks(2)": "  ",
}
WRONG = {
    "Kp": "line 1, column 1: Kp is not defined",
    "lenght(x)": "unknown function lenght. Did you mean length?",
    "tf(1, [1 1])": "unknown function tf",
    "1 + wrod": "line 1, column 5: wrod is not defined. Did you mean word?",
    "x(4)": "the index is 4, but the size is 3",
    "x(0)": "indices must be integers >= 1, got 0",
    "x(1.5)": "indices must be integers >= 1, got 1.5",
    "A(3, 1)": "index 1 is 3, but the size is 2",
    "x + [1 2]": "the sizes 1 x 3 and 1 x 2 are not compatible",
    "x * x": "matrices of size 1 x 3 and 1 x 3 are not compatible with *; use .* for their elements",
    "[1 2; 3]": "arrays of size 1 x 2, 1 x 1 cannot be concatenated vertically",
    "sqrt(-1)": "sqrt: the root of a negative number is complex",
    "(-8)^(1/3)": "a fractional power of a negative number is complex",
    "2i": "complex numbers are not supported",
    "int8(1) + uint8(1)": "cannot be combined",
    "s.z": "unknown field z",
    "s.b.aa": "unknown field aa",
    "x.a": "a double has no field a",
    "x{1}": "a double cannot be indexed with braces",
    "c{:} + 1": "this expression has 3 values, expected one",
    "zeros(1e9)": "requires too much memory",
    "zeros(1e5, 1e5)": "requires too much memory",
    "1:1e12": "requires too much memory",
    "0:1e-300:1": "requires too much memory",
    "repmat(1, 1e6, 1e6)": "requires too much memory",
    "linspace(0, 1, 1e12)": "requires too much memory",
    "1:Inf": "the range is infinite",
    "ones(1, 2.5)": "a size must be an integer",
    "size()": "size takes 1 to 2 arguments, got 0",
    "sin(1, 2)": "sin takes 1 arguments, got 2",
    "inv([1 1; 1 1])": "inv cannot be computed for these arguments (double of 2 x 2)",
    "[1 1; 1 1] \\ [1; 2]": "the linear system cannot be solved",
    "interp1([1 1], [1 2], 1)": "the points must be at least two distinct finite numbers",
    "interp1([1 2 3], [1 2], 1)": "3 points, but 2 values",
    "reshape(1:6, 4, 2)": "6 elements cannot be reshaped to 4 x 2",
    "NaN && 1": "NaN is neither true nor false",
    "sprintf('%*d', 1, 2)": "the width of %*d is not supported",
    "feval(@(f) f(f), @(f) f(f))": "function calls are nested too deeply",
    "fieldnames(5)": "must be a struct, got a double",
    "[struct('a', 1), @sin]": "a struct can be concatenated with structs only",
    "[struct('a', 1), struct('b', 1)]": "structs with different fields cannot be concatenated",
    "[struct('a', {1, 2}); struct('a', 3)]": "arrays of size 1 x 2, 1 x 1 cannot be concatenated vertically",
    "char(-1)": "a number is not a character code",
    "(end)": "a value is missing",
}


@pytest.mark.parametrize(("text", "wanted"), [item for item in NUMBERS.items() if item[1] is not None])
def test_an_expression_has_this_value(text, wanted):
    value = evaluate(text, VARIABLES)
    wanted = np.asarray(wanted)
    wanted = wanted.reshape(1, 1) if wanted.ndim == 0 else wanted
    assert value.shape == wanted.shape
    assert (value.dtype == np.bool_) == (wanted.dtype == np.bool_) or not wanted.size
    np.testing.assert_allclose(value.astype(float), wanted.astype(float), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize(("expression", "wanted"), TEXTS.items())
def test_an_expression_is_this_text(expression, wanted):
    assert text(evaluate(expression, VARIABLES)) == wanted


@pytest.mark.parametrize(("expression", "said"), WRONG.items())
def test_expressions_without_a_value_are_reported(expression, said):
    with pytest.raises(MatlabError, match=re.escape(said)):
        evaluate(expression, VARIABLES)


def test_cells_and_structs_are_values():
    cell = evaluate("{1, 'a'; {}, [1 2]}")
    assert isinstance(cell, MatlabCell)
    assert cell.values.shape == (2, 2)
    struct = evaluate("struct('a', {{1, 2}}, 'b', 3)")
    assert isinstance(struct, MatlabStruct)
    assert struct.names == ("a", "b")
    assert struct.fields["a"].values.size == 2


def test_functions_of_the_caller_come_first():
    functions = {"lookup": lambda x: x * 10, "sin": lambda x: "none", "two": lambda: (1.0, 2.0)}
    assert evaluate("lookup(3) + 1", functions=functions).tolist() == [[31.0]]
    assert text(evaluate("sin(1)", functions=functions)) == "none"


def test_the_names_of_an_expression_are_those_from_outside():
    names = names_read(parse_expression("K*interp1(x.y, [1 2], u(end)) + arrayfun(@(a) a*b, c{:})"))
    assert names == {"K", "interp1", "x", "u", "arrayfun", "b", "c"}


def test_a_variable_comes_before_a_function():
    assert evaluate("sum(2)", {"sum": np.array([5.0, 6.0])}).tolist() == [[6.0]]


def test_evaluation_does_not_change_its_inputs():
    given_array = np.array([[1.0, 2.0]])
    evaluate("cumsum(x)", {"x": given_array})
    assert given_array.tolist() == [[1.0, 2.0]]


def test_a_budget_of_steps_ends_long_evaluations():
    with pytest.raises(MatlabError, match="too many steps"):
        evaluate("arrayfun(@(a) a + 1, 1:1000)", budget=Budget(steps=500))


def test_python_values_become_values():
    assert class_name(evaluate("a", {"a": np.float32(1.0)})) == "single"
    assert evaluate("a + 1", {"a": 3}).tolist() == [[4.0]]
    with pytest.raises(TypeError, match="object has no counterpart"):
        evaluate("a", {"a": object()})


small = arrays(np.float64, st.tuples(st.integers(1, 3), st.integers(1, 3)), elements=st.floats(-1e3, 1e3))


@few_or_many(small, few=8, many=100)
def test_reshaping_and_turning_back_changes_nothing(values):
    assert np.array_equal(evaluate("a''", {"a": values}), values)
    assert np.array_equal(evaluate("reshape(a(:), size(a))", {"a": values}), values)
    assert np.array_equal(evaluate("a(1:end, 1:end)", {"a": values}), values)
    assert np.array_equal(evaluate("fliplr(flipud(a))", {"a": values}), evaluate("rot90(a, 2)", {"a": values}))


@few_or_many(st.floats(-1e3, 1e3), st.floats(0.01, 10), st.integers(0, 1000), few=20, many=100)
def test_a_range_holds_as_many_steps_as_fit(begin, step, count):
    points = evaluate("a:h:a+n*h", {"a": begin, "h": step, "n": count})
    assert points.size == count + 1
    assert points[0, -1] <= begin + count * step


PIECES = ["x", "A", "c", "s", "K", "word", "1", "0", "[]", "''", "{}", "(", ")", "[", "]", "{", "}", ",", ";", ":", "+"]
PIECES += ["*", "^", "'", ".a", "end", "==", "sum(", "zeros(", "@(x)", "cellfun(", "reshape(", "strcat(", "interp1("]
PIECES += ["max(", "sort(", "unique(", "num2str(", "sprintf('%d',", "NaN", "1e9", "-", "~", "int8(", "find(", "A(:,"]


@few_or_many(st.lists(st.sampled_from(PIECES), max_size=12).map("".join), few=20, many=100)
def test_any_expression_has_a_value_or_the_error_of_the_room(expression):
    with contextlib.suppress(MatlabError):
        assert class_name(evaluate(expression, VARIABLES, budget=Budget(elements=100_000)))
