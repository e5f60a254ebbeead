% Values of exhaust.mdl as they came with the model
NAxis = [800 1600 2400 3200 4400];   % rpm
LoadAxis = [15 35 60 90];            % %
MapGas = 500 * ones(5, 4);           % degC
KRetard = 3.0;                       % degC per degree of late ignition
TauSensor = 12.0;                    % s
