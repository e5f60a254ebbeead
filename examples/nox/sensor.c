/* NOx sensor of the control unit: rising and falling values have lags of their own, the signal ends at 3000 ppm. */
#include <math.h>

#define LIMIT_PPM 3000.0

double sensor(double raw, double rise, double fall, double dt)
{
    static int started = 0;
    static double signal;
    double change;

    if (!started) {
        signal = raw;
        started = 1;
    }
    change = raw - signal;
    signal += dt / (rise + dt) * fmax(change, 0.0) + dt / (fall + dt) * fmin(change, 0.0);
    return fmin(fmax(signal, 0.0), LIMIT_PPM);
}
