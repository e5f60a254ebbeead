"""An A2L file and images for a small project: a curve Gain over Speed and a scalar offset, in hundredths and tenths."""

A2L = """\
ASAP2_VERSION 1 61
/begin PROJECT P "" /begin MODULE M ""
/begin MOD_COMMON "" BYTE_ORDER MSB_FIRST /end MOD_COMMON
/begin RECORD_LAYOUT RL FNC_VALUES 1 UWORD ROW_DIR DIRECT /end RECORD_LAYOUT
/begin COMPU_METHOD HUNDREDTH "" LINEAR "%5.2" "Nm" COEFFS_LINEAR 0.01 0 /end COMPU_METHOD
/begin COMPU_METHOD TENTH "" LINEAR "%5.1" "Nm" COEFFS_LINEAR 0.1 0 /end COMPU_METHOD
/begin CHARACTERISTIC Gain "" CURVE 0x1000 RL 0 HUNDREDTH 0 0
  /begin AXIS_DESCR FIX_AXIS Speed NO_COMPU_METHOD 3 0 0 FIX_AXIS_PAR_DIST 1000 1000 3 /end AXIS_DESCR
/end CHARACTERISTIC
/begin CHARACTERISTIC offset "" VALUE 0x1006 RL 0 TENTH 0 0 /end CHARACTERISTIC
/end MODULE /end PROJECT
"""


def hex_of(*numbers, size=2):
    """Intel HEX of numbers at 0x1000."""
    content = b"".join(number.to_bytes(size, "big") for number in numbers)
    body = bytes([len(content), 0x10, 0, 0]) + content
    return f":{body.hex().upper()}{-sum(body) % 256:02X}\n:00000001FF\n"


def memory_of(raw):
    """The numbers of such a file."""
    content = bytes.fromhex(raw.decode().splitlines()[0][9:-2])
    return [int.from_bytes(content[at : at + 2], "big") for at in range(0, len(content), 2)]
