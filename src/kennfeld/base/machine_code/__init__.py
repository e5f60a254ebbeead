"""Generation and compilation of machine code: text of LLVM functions, and their compilation in memory."""
