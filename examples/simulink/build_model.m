function error_percent = build_model(folder, step, delayed)
%BUILD_MODEL The machine in Simulink: four FMU blocks, wired as in harvester.ssp; runs the work cycle.
%
%   build_model()                          FMUs of ../../build, 1 ms
%   build_model('../../build', 2e-3)       another communication step
%   build_model('../../build', 1e-3, true) with a Unit Delay in each wire, see README.md
%
%   Returns and prints the worst error of a joint speed over its range [%]; 0.01 is right, 100 is lost.

    here = fileparts(mfilename('fullpath'));
    if nargin < 1, folder = fullfile(here, '..', '..', 'build'); end
    if nargin < 2, step = 1e-3; end
    if nargin < 3, delayed = false; end
    model = 'harvester';
    addpath(folder);  % the FMU block looks for files on the path
    load_system('simulink_extras');
    if bdIsLoaded(model), close_system(model, 0); end
    new_system(model);
    set_param(model, 'SolverType', 'Fixed-step', 'Solver', 'FixedStepDiscrete', ...
        'FixedStep', num2str(step, 17), 'StopTime', '42');
    parts = struct();
    names = {'manipulator', 'boom_stick', 'swing', 'operator_input'};
    for k = 1:numel(names)
        parts.(names{k}) = add_part(model, names{k}, folder, step, k);
    end
    table = wires();
    for k = 1:size(table, 1)
        connect(model, parts, table{k, 1}, table{k, 2}, step, delayed);
    end
    hold_supply(model, parts);
    record(model, parts);
    error_percent = judge(sim(model), fullfile(here, '..', '..', 'data', 'reference', 'work_cycle.csv'));
    fprintf('worst joint speed: %.3g %% of range from the reference\n', error_percent);
end

function part = add_part(model, name, folder, step, place)
% An FMU block, and its ports by name: they stand in the order of the model description.
    block = [model '/' name];
    add_block('simulink_extras/FMU Import/FMU', block, 'Position', [300 * place, 50, 300 * place + 180, 550]);
    set_param(block, 'FMUName', [name '.fmu'], 'FMUMode', 'CoSimulation');
    set_param(block, 'FMUSampleTime', num2str(step, 17));
    part = struct('block', block, 'inputs', {{}}, 'outputs', {{}}, 'starts', struct());
    unpacked = tempname;
    unzip(fullfile(folder, [name '.fmu']), unpacked);
    variables = xmlread(fullfile(unpacked, 'modelDescription.xml')).getElementsByTagName('ScalarVariable');
    for k = 0:variables.getLength - 1
        variable = variables.item(k);
        label = char(variable.getAttribute('name'));
        switch char(variable.getAttribute('causality'))
            case 'input'
                part.inputs{end + 1} = label;
                real = variable.getElementsByTagName('Real').item(0);
                part.starts.(label) = char(real.getAttribute('start'));
            case 'output'
                part.outputs{end + 1} = label;
        end
    end
    rmdir(unpacked, 's');
    ports = get_param(block, 'PortHandles');
    assert(numel(ports.Inport) == numel(part.inputs) && numel(ports.Outport) == numel(part.outputs), ...
        '%s: the block does not show all inputs and outputs as ports, see its tabs Inputs and Outputs', name);
end

function connect(model, parts, from, to, step, delayed)
% One wire, with a delay of one step where the FMU blocks want one.
    [source, out] = port(parts, from, 'outputs');
    [target, in] = port(parts, to, 'inputs');
    if ~delayed
        add_line(model, source, target, 'autorouting', 'on');
        return
    end
    ends = strsplit(to, '.');
    block = [model '/' strrep(to, '.', '_')];
    add_block('simulink/Discrete/Unit Delay', block, 'SampleTime', num2str(step, 17), ...
        'InitialCondition', parts.(ends{1}).starts.(ends{2}));
    handles = get_param(block, 'PortHandles');
    add_line(model, out, handles.Inport, 'autorouting', 'on');
    add_line(model, handles.Outport, in, 'autorouting', 'on');
end

function [label, handle] = port(parts, name, side)
% 'swing.swing_torque' as 'swing/1', and its handle.
    ends = strsplit(name, '.');
    part = parts.(ends{1});
    number = find(strcmp(part.(side), ends{2}));
    assert(isscalar(number), '%s: no such port among the %s', name, side);
    label = sprintf('%s/%d', ends{1}, number);
    handles = get_param(part.block, 'PortHandles');
    kinds = struct('inputs', 'Inport', 'outputs', 'Outport');
    handle = handles.(kinds.(side))(number);
end

function hold_supply(model, parts)
% Simulink gives zero to an open input: the supply line needs its pressure [Pa].
    for name = {'swing', 'boom_stick'}
        for line = {'supply_pressure', '20.684e6'; 'tank_pressure', '0'}'
            block = [name{1} '_' line{1}];
            add_block('simulink/Sources/Constant', [model '/' block], 'Value', line{2});
            add_line(model, [block '/1'], port(parts, [name{1} '.' line{1}], 'inputs'));
        end
    end
end

function record(model, parts)
% The joint speeds to the workspace.
    for joint = {'swing', 'boom', 'stick'}
        speed = [joint{1} '_speed'];
        add_block('simulink/Sinks/To Workspace', [model '/log_' speed], ...
            'VariableName', speed, 'SaveFormat', 'Timeseries');
        add_line(model, port(parts, ['manipulator.' speed], 'outputs'), ['log_' speed '/1']);
    end
end

function worst = judge(out, file)
% Root mean square error over range of the worst joint speed [%].
    reference = readtable(file, 'VariableNamingRule', 'preserve');
    worst = 0;
    for joint = {'swing', 'boom', 'stick'}
        found = out.get([joint{1} '_speed']);
        true_speed = reference.(['manipulator.' joint{1} '_speed']);
        difference = interp1(found.Time, squeeze(found.Data), reference.time) - true_speed;
        worst = max(worst, 100 * sqrt(mean(difference .^ 2, 'omitnan')) / (max(true_speed) - min(true_speed)));
    end
end

function table = wires()
% From and to; the rate ports are those that end in _rate and _acceleration.
    table = {
        'swing.swing_torque',             'manipulator.swing_torque'
        'manipulator.swing_speed',        'swing.swing_speed'
        'boom_stick.boom_force',          'manipulator.boom_force'
        'manipulator.boom_position',      'boom_stick.boom_position'
        'manipulator.boom_velocity',      'boom_stick.boom_velocity'
        'boom_stick.stick_force',         'manipulator.stick_force'
        'manipulator.stick_position',     'boom_stick.stick_position'
        'manipulator.stick_velocity',     'boom_stick.stick_velocity'
        'swing.swing_torque_rate',        'manipulator.swing_torque_rate'
        'manipulator.swing_acceleration', 'swing.swing_acceleration'
        'boom_stick.boom_force_rate',     'manipulator.boom_force_rate'
        'manipulator.boom_acceleration',  'boom_stick.boom_acceleration'
        'boom_stick.stick_force_rate',    'manipulator.stick_force_rate'
        'manipulator.stick_acceleration', 'boom_stick.stick_acceleration'
        'manipulator.boom_holding_force', 'boom_stick.boom_holding_force'
        'manipulator.stick_holding_force', 'boom_stick.stick_holding_force'
        'operator_input.swing_command',         'swing.swing_command'
        'operator_input.swing_command_rate',    'swing.swing_command_rate'
        'operator_input.boom_command',          'boom_stick.boom_command'
        'operator_input.boom_command_rate',     'boom_stick.boom_command_rate'
        'operator_input.stick_command',         'boom_stick.stick_command'
        'operator_input.stick_command_rate',    'boom_stick.stick_command_rate'
        'operator_input.payload_mass',          'manipulator.payload_mass'
    };
end
