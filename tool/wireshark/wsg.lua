-- Wireshark dissector for Weiss Robotics WSG grippers over TCP and UDP: the binary command protocol and GCL.
--
-- Copy it to the folder of personal Lua plugins (Help, About Wireshark, Folders), or run: wireshark -X lua_script:wsg.lua
-- Filters: wsg.id, wsg.status, wsg.checksum.right == 0, wsg.opening_width > 20, wsg.meaning contains "Grip"; gcl.line
--
-- Requires Wireshark 4, with Lua 5.2 to 5.4. A test generates the tables from those of the crate wsg-protocol:
-- WSG_UPDATE_DOCS=1 cargo test -p host-tests --test docs

--[[ <!-- generated: tables -->
]]
local COMMANDS = {
  [0x06] = { name = "Loop", request = { { "data", "LoopData", "" } }, reply = { { "loop", "LoopData", "" } } },
  [0x07] = { name = "Disconnect Announcement", request = {  }, reply = {  } },
  [0x20] = { name = "Homing", request = { { "direction", "HomingDirection", "" } }, reply = {  } },
  [0x21] = { name = "Pre-position Fingers", request = { { "flags", "PrePositionFlags", "" }, { "width", "f32", "mm" }, { "speed", "f32", "mm/s" } }, reply = {  } },
  [0x22] = { name = "Stop", request = {  }, reply = {  } },
  [0x23] = { name = "Issue FAST STOP", request = {  }, reply = {  } },
  [0x24] = { name = "Acknowledge FAST STOP", request = { { "key", "AckKey", "" } }, reply = {  } },
  [0x25] = { name = "Grip Part", request = { { "width", "f32", "mm" }, { "speed", "f32", "mm/s" } }, reply = {  } },
  [0x26] = { name = "Release Part", request = { { "width", "f32", "mm" }, { "speed", "f32", "mm/s" } }, reply = {  } },
  [0x30] = { name = "Set Acceleration", request = { { "acceleration", "f32", "mm/s²" } }, reply = {  } },
  [0x31] = { name = "Get Acceleration", request = {  }, reply = { { "acceleration", "f32", "mm/s²" } } },
  [0x32] = { name = "Set Force Limit", request = { { "force", "f32", "N" } }, reply = {  } },
  [0x33] = { name = "Get Force Limit", request = {  }, reply = { { "force_limit", "f32", "N" } } },
  [0x34] = { name = "Set Soft Limits", request = { { "limits", "SoftLimits", "" } }, reply = {  } },
  [0x35] = { name = "Get Soft Limits", request = {  }, reply = { { "soft_limits", "SoftLimits", "" } } },
  [0x36] = { name = "Clear Soft Limits", request = {  }, reply = {  } },
  [0x37] = { name = "Overdrive Mode", request = { { "enabled", "bool", "" } }, reply = {  } },
  [0x38] = { name = "Tare Force Sensor", request = {  }, reply = {  } },
  [0x40] = { name = "Get System State", request = { { "update", "AutoUpdate", "" } }, reply = { { "system_state", "SystemFlags", "" } } },
  [0x41] = { name = "Get Gripper State", request = { { "update", "AutoUpdate", "" } }, reply = { { "gripper_state", "GripperState", "" } } },
  [0x42] = { name = "Get Gripping Statistics", request = { { "reset", "bool", "" } }, reply = { { "gripping_statistics", "GrippingStatistics", "" } } },
  [0x43] = { name = "Get Opening Width", request = { { "update", "AutoUpdate", "" } }, reply = { { "opening_width", "f32", "mm" } } },
  [0x44] = { name = "Get Speed", request = { { "update", "AutoUpdate", "" } }, reply = { { "speed", "f32", "mm/s" } } },
  [0x45] = { name = "Get Force", request = { { "update", "AutoUpdate", "" } }, reply = { { "force", "f32", "N" } } },
  [0x46] = { name = "Get Temperature", request = {  }, reply = { { "temperature", "Temperature", "" } } },
  [0x50] = { name = "Get System Information", request = {  }, reply = { { "system_information", "SystemInfo", "" } } },
  [0x51] = { name = "Set Device Tag", request = { { "tag", "DeviceTag", "" } }, reply = {  } },
  [0x52] = { name = "Get Device Tag", request = {  }, reply = { { "device_tag", "DeviceTag", "" } } },
  [0x53] = { name = "Get System Limits", request = {  }, reply = { { "system_limits", "SystemLimits", "" } } },
  [0x60] = { name = "Get Finger 1 Info", request = {  }, reply = { { "finger_1_info", "FingerInfo", "" } } },
  [0x61] = { name = "Get Finger 1 Flags", request = {  }, reply = { { "finger_1_flags", "FingerFlags", "" } } },
  [0x62] = { name = "Finger 1 Power Control", request = { { "enabled", "bool", "" } }, reply = {  } },
  [0x63] = { name = "Get Finger 1 Data", request = {  }, reply = { { "finger_1_data", "FingerData", "" } } },
  [0x70] = { name = "Get Finger 2 Info", request = {  }, reply = { { "finger_2_info", "FingerInfo", "" } } },
  [0x71] = { name = "Get Finger 2 Flags", request = {  }, reply = { { "finger_2_flags", "FingerFlags", "" } } },
  [0x72] = { name = "Finger 2 Power Control", request = { { "enabled", "bool", "" } }, reply = {  } },
  [0x73] = { name = "Get Finger 2 Data", request = {  }, reply = { { "finger_2_data", "FingerData", "" } } },
}
local STATUS = {
  [0] = "E_SUCCESS",
  [1] = "E_NOT_AVAILABLE",
  [2] = "E_NO_SENSOR",
  [3] = "E_NOT_INITIALIZED",
  [4] = "E_ALREADY_RUNNING",
  [5] = "E_FEATURE_NOT_SUPPORTED",
  [6] = "E_INCONSISTENT_DATA",
  [7] = "E_TIMEOUT",
  [8] = "E_READ_ERROR",
  [9] = "E_WRITE_ERROR",
  [10] = "E_INSUFFICIENT_RESOURCES",
  [11] = "E_CHECKSUM_ERROR",
  [12] = "E_NO_PARAM_EXPECTED",
  [13] = "E_NOT_ENOUGH_PARAMS",
  [14] = "E_CMD_UNKNOWN",
  [15] = "E_CMD_FORMAT_ERROR",
  [16] = "E_ACCESS_DENIED",
  [17] = "E_ALREADY_OPEN",
  [18] = "E_CMD_FAILED",
  [19] = "E_CMD_ABORTED",
  [20] = "E_INVALID_HANDLE",
  [21] = "E_NOT_FOUND",
  [22] = "E_NOT_OPEN",
  [23] = "E_IO_ERROR",
  [24] = "E_INVALID_PARAMETER",
  [25] = "E_INDEX_OUT_OF_BOUNDS",
  [26] = "E_CMD_PENDING",
  [27] = "E_OVERRUN",
  [28] = "E_RANGE_ERROR",
  [29] = "E_AXIS_BLOCKED",
  [30] = "E_FILE_EXISTS",
}
local GRIPPER_STATES = {
  [0] = "IDLE",
  [1] = "GRIPPING",
  [2] = "NO PART",
  [3] = "PART LOST",
  [4] = "HOLDING",
  [5] = "RELEASING",
  [6] = "POSITIONING",
  [7] = "ERROR",
}
local HOMING_DIRECTIONS = {
  [0] = "default direction",
  [1] = "positive direction",
  [2] = "negative direction",
}
local DEVICE_TYPES = {
  [0] = "unknown",
  [1] = "WSG 50",
  [2] = "WSG 32",
  [3] = "KMS 40",
  [4] = "WTS",
  [5] = "WSG 25",
  [6] = "WSG 70",
}
local FINGER_TYPES = {
  [0] = "generic or none",
  [1] = "WSG-FMF",
  [2] = "WSG-DSA",
}
local SYSTEM_FLAGS = {
  { 0, "REFERENCED" },
  { 1, "MOVING" },
  { 2, "BLOCKED_MINUS" },
  { 3, "BLOCKED_PLUS" },
  { 4, "SOFT_LIMIT_MINUS" },
  { 5, "SOFT_LIMIT_PLUS" },
  { 6, "AXIS_STOPPED" },
  { 7, "TARGET_POS_REACHED" },
  { 8, "OVERDRIVE_MODE" },
  { 9, "FORCECNTL_MODE" },
  { 12, "FAST_STOP" },
  { 13, "TEMP_WARNING" },
  { 14, "TEMP_FAULT" },
  { 15, "POWER_FAULT" },
  { 16, "CURR_FAULT" },
  { 17, "FINGER_FAULT" },
  { 18, "CMD_FAILURE" },
  { 19, "SCRIPT_RUNNING" },
  { 20, "SCRIPT_FAILURE" },
}
local FINGER_FLAGS = {
  { 0, "POWER_ON" },
  { 1, "CONFIG_AVAIL" },
  { 2, "COMM_OPEN" },
  { 8, "POWER_FAULT" },
  { 9, "COMM_FAULT" },
  { 10, "INIT_FAULT" },
}
local PRE_POSITION_FLAGS = {
  { 0, "RELATIVE" },
  { 1, "STOP_ON_BLOCK" },
}
local GCL_COMMANDS = {
  VERBOSE = "setting",
  BYE = "connection",
  HOME = "motion",
  MOVE = "motion",
  GRIP = "motion",
  RELEASE = "motion",
  PWT = "setting",
  CLT = "setting",
  POS = "query",
  SPEED = "query",
  FORCE = "query",
  GRIPSTATE = "query",
  DEVTYPE = "query",
  VERSION = "query",
  SN = "query",
  TAG = "query",
  SYSFLAGS = "query",
  TEMP = "query",
  AUTOSEND = "setting",
  STOP = "stop",
  FASTSTOP = "stop",
  FSACK = "acknowledge",
  TARE = "setting",
  GRIPSTATS = "query",
  FDATA = "query",
  FTYPE = "query",
  FFLAGS = "query",
}
--[[
<!-- end --> ]]

local PREAMBLE, HEAD, OVERHEAD, LONGEST = 0xAA, 6, 8, 1016
local bxor = (bit32 or bit).bxor

-- The checksum: a table of polynomial 1021h, used with a right shift (command set, appendix D).
local SUMS = {}
for index = 0, 255 do
  local sum = index * 256
  for _ = 1, 8 do
    sum = sum * 2
    if sum >= 0x10000 then
      sum = bxor(sum - 0x10000, 0x1021)
    end
  end
  SUMS[index] = sum
end

local function checksum(range)
  local bytes, sum = range:bytes(), 0xFFFF
  for at = 0, bytes:len() - 1 do
    sum = bxor(SUMS[bxor(sum % 256, bytes:get_index(at))], math.floor(sum / 256))
  end
  return sum
end

local binary = Proto("wsg", "WSG gripper, binary protocol")
local gcl = Proto("gcl", "WSG gripper, GCL")

local id_names, status_names = {}, {}
for id, command in pairs(COMMANDS) do
  id_names[id] = command.name
end
for code, name in pairs(STATUS) do
  status_names[code] = name
end

local field = {
  request = ProtoField.bool("wsg.request", "To the gripper"),
  id = ProtoField.uint8("wsg.id", "Command", base.HEX, id_names),
  size = ProtoField.uint16("wsg.size", "Payload length", base.DEC),
  status = ProtoField.uint16("wsg.status", "Status", base.DEC, status_names),
  payload = ProtoField.bytes("wsg.payload", "Payload"),
  checksum = ProtoField.uint16("wsg.checksum", "Checksum", base.HEX),
  checksum_right = ProtoField.bool("wsg.checksum.right", "Checksum correct"),
  meaning = ProtoField.string("wsg.meaning", "Meaning"),
  dropped = ProtoField.bytes("wsg.dropped", "Dropped bytes"),
}
local value_fields = {}
for _, command in pairs(COMMANDS) do
  for _, values in ipairs({ command.request, command.reply }) do
    for _, value in ipairs(values) do
      local name, kind = value[1], value[2]
      local make = kind == "f32" and ProtoField.float or kind == "bool" and ProtoField.bool or ProtoField.string
      value_fields[name] = value_fields[name] or make("wsg." .. name, (name:gsub("_", " ")))
    end
  end
end
local fields = {}
for _, one in pairs(field) do
  fields[#fields + 1] = one
end
for _, one in pairs(value_fields) do
  fields[#fields + 1] = one
end
binary.fields = fields

local problem = {
  checksum = ProtoExpert.new("wsg.checksum.bad", "Wrong checksum", expert.group.CHECKSUM, expert.severity.ERROR),
  dropped = ProtoExpert.new("wsg.dropped.noise", "No preamble", expert.group.MALFORMED, expert.severity.WARN),
  too_long = ProtoExpert.new("wsg.too_long", "Payload size exceeds the maximum", expert.group.MALFORMED, expert.severity.WARN),
  incomplete = ProtoExpert.new("wsg.incomplete", "Truncated frame", expert.group.MALFORMED, expert.severity.ERROR),
  refused = ProtoExpert.new("wsg.refused", "Payload not permitted by the manual", expert.group.PROTOCOL, expert.severity.WARN),
}
binary.experts = { problem.checksum, problem.dropped, problem.too_long, problem.incomplete, problem.refused }

-- Creates a reader for a payload: a range of bytes and the current position.
local function reader(range)
  return { range = range, at = 0, len = range and range:len() or 0 }
end

local function take(input, len)
  if input.len - input.at < len then
    return nil, "payload too short"
  end
  local part = input.range(input.at, len)
  input.at = input.at + len
  return part
end

local function take_rest(input)
  local len = input.len - input.at
  if len == 0 then
    return nil, 0
  end
  return take(input, len), len
end

local function has(bits, bit)
  return math.floor(bits / 2 ^ bit) % 2 == 1
end

local function flags_text(bits, names)
  local words = {}
  for _, flag in ipairs(names) do
    if has(bits, flag[1]) then
      words[#words + 1] = flag[2]
      bits = bits - 2 ^ flag[1]
    end
  end
  if bits > 0 then
    words[#words + 1] = string.format("0x%x", bits)
  end
  return #words > 0 and table.concat(words, " | ") or "0"
end

-- Returns a number with a decimal, from 1e15 on with an exponent.
local function number(value)
  if math.abs(value) < 1e15 then
    return string.format("%.1f", value)
  end
  return (string.format("%.1e", value):gsub("e%+", "e"))
end

local function finite(part)
  local value = part:le_float()
  if value ~= value or value == math.huge or value == -math.huge then
    return nil, "number not finite"
  end
  return value
end

local function flags(len, names)
  return function(input)
    local part, why = take(input, len)
    if not part then
      return nil, why
    end
    return { part, flags_text(part:le_uint(), names) }
  end
end

-- Returns a parser for consecutive floats, each with a prefix and a suffix.
local function floats(...)
  local words = { ... }
  return function(input)
    local part, why = take(input, 4 * #words)
    if not part then
      return nil, why
    end
    local texts = {}
    for index, word in ipairs(words) do
      local value, refused = finite(part(4 * index - 4, 4))
      if not value then
        return nil, refused
      end
      texts[index] = string.format("%s %s %s", word[1], number(value), word[2])
    end
    return { part, table.concat(texts, ", ") }
  end
end

-- Parsers of the types. Each returns the bytes, the text and, for numbers and switches, the value; or nil and the reason.
local TYPES = {
  f32 = function(input)
    local part, why = take(input, 4)
    if not part then
      return nil, why
    end
    local value, refused = finite(part)
    if not value then
      return nil, refused
    end
    return { part, number(value), value }
  end,
  bool = function(input)
    local part, why = take(input, 1)
    if not part then
      return nil, why
    end
    local value = part:uint()
    if value > 1 then
      return nil, "reserved bits set"
    end
    return { part, value == 1 and "on" or "off", value == 1 }
  end,
  LoopData = function(input)
    local part, len = take_rest(input)
    if len and part and len > 256 then
      return nil, "payload too long"
    end
    return { part, (part and len or 0) .. " bytes" }
  end,
  FingerData = function(input)
    local part, len = take_rest(input)
    return { part, (part and len or 0) .. " bytes" }
  end,
  HomingDirection = function(input)
    local part, why = take(input, 1)
    if not part then
      return nil, why
    end
    local words = HOMING_DIRECTIONS[part:uint()]
    if not words then
      return nil, "undefined value"
    end
    return { part, words }
  end,
  GripperState = function(input)
    local part, why = take(input, 1)
    if not part then
      return nil, why
    end
    local words = GRIPPER_STATES[part:uint()]
    if not words then
      return nil, "undefined value"
    end
    return { part, words }
  end,
  PrePositionFlags = function(input)
    local part, why = take(input, 1)
    if not part then
      return nil, why
    end
    if part:uint() > 3 then
      return nil, "reserved bits set"
    end
    return { part, flags_text(part:uint(), PRE_POSITION_FLAGS) }
  end,
  AckKey = function(input)
    local part, why = take(input, 3)
    if not part then
      return nil, why
    end
    if part:raw() ~= "ack" then
      return nil, 'acknowledge key is not "ack"'
    end
    return { part, '"ack"' }
  end,
  SoftLimits = floats({ "from", "mm" }, { "to", "mm" }),
  SystemLimits = floats(
    { "stroke", "mm" },
    { "speed from", "mm/s" },
    { "to", "mm/s" },
    { "acceleration from", "mm/s²" },
    { "to", "mm/s²" },
    { "force from", "N" },
    { "nominal", "N" },
    { "overdrive", "N" }
  ),
  AutoUpdate = function(input)
    local part, why = take(input, 3)
    if not part then
      return nil, why
    end
    local bits, period = part(0, 1):uint(), part(1, 2):le_uint()
    if bits > 3 then
      return nil, "reserved bits set"
    elseif not has(bits, 0) then
      return { part, "once" }
    elseif has(bits, 1) then
      return { part, string.format("on change, %d ms apart", period) }
    end
    return { part, string.format("every %d ms", period) }
  end,
  DeviceTag = function(input)
    local part = take_rest(input)
    local text = part and part:raw() or ""
    if text:find("[\128-\255]") then
      return nil, "control or non-ASCII character"
    end
    text = text:gsub("%z+$", "")
    if #text > 64 then
      return nil, "tag longer than 64 characters"
    elseif text:find("[%z\1-\31\127]") then
      return nil, "control or non-ASCII character"
    end
    return { part, '"' .. text .. '"' }
  end,
  SystemFlags = flags(4, SYSTEM_FLAGS),
  FingerFlags = flags(2, FINGER_FLAGS),
  GrippingStatistics = function(input)
    local part, why = take(input, 8)
    if not part then
      return nil, why
    end
    local all, without, lost = part(0, 4):le_uint(), part(4, 2):le_uint(), part(6, 2):le_uint()
    return { part, string.format("%d grips, %d without part, %d lost", all, without, lost) }
  end,
  Temperature = function(input)
    local part, why = take(input, 2)
    if not part then
      return nil, why
    end
    return { part, string.format("%.1f °C", part:le_int() / 10) }
  end,
  SystemInfo = function(input)
    local part, why = take(input, 8)
    if not part then
      return nil, why
    end
    local device, revision = part(0, 1):uint(), part(1, 1):uint()
    local name = DEVICE_TYPES[device] or string.format("reserved (%d)", device)
    local low, high = part(2, 1):uint(), part(3, 1):uint()
    local version = string.format("%d.%d.%d", math.floor(high / 16), high % 16, math.floor(low / 16))
    if low % 16 > 0 then
      version = version .. string.format("-rc%d", low % 16)
    end
    local words = "%s, revision %d, firmware %s, serial number %.0f"
    return { part, words:format(name, revision, version, part(4, 4):le_uint()) }
  end,
  FingerInfo = function(input)
    local part, why = take(input, 3)
    if not part then
      return nil, why
    end
    local finger = part(0, 1):uint()
    local name = FINGER_TYPES[finger] or string.format("reserved (%d)", finger)
    return { part, string.format("%s, %d bytes of data", name, part(1, 2):le_uint()) }
  end,
}

-- Parses the values of a request or reply. Returns their text, or nil and the reason.
local function take_values(values, input, tree)
  local words = ""
  for _, value in ipairs(values) do
    local name, kind, unit = value[1], value[2], value[3]
    local taken, why = TYPES[kind](input)
    if not taken then
      return nil, why
    end
    local part, text, number = taken[1], taken[2], taken[3]
    if unit ~= "" then
      text = text .. " " .. unit
    end
    words = words .. " " .. text
    if part then
      local item
      if number ~= nil then
        item = tree:add(value_fields[name], part, number)
      else
        item = tree:add(value_fields[name], part, text)
      end
      if unit ~= "" then
        item:append_text(" " .. unit)
      end
    end
  end
  if input.at < input.len then
    return nil, "payload too long"
  end
  return words
end

-- Describes a frame like the crate wsg-protocol. Also returns whether its payload is invalid.
local function describe(id, payload, is_request, tree)
  local command = COMMANDS[id]
  local input = reader(payload)
  local is_script = id >= 0xA0 and id <= 0xBF
  local name = command and command.name or is_script and "script command" or "unknown command"
  local title = string.format("%02Xh %s", id, name)
  local words, why
  if is_request then
    if not command then
      return string.format("%s %d bytes", title, input.len), false
    end
    words, why = take_values(command.request, input, tree)
  else
    local part
    part, why = take(input, 2)
    if part then
      tree:add_le(field.status, part)
      local code = part:le_uint()
      local status = STATUS[code] or string.format("E_? (%d)", code)
      if code == 0 and not command then
        words = string.format(" %s %d bytes", status, input.len - input.at)
      else
        words, why = take_values(code == 0 and command.reply or {}, input, tree)
        words = words and " " .. status .. words
      end
    end
  end
  if words then
    return title .. words, false
  end
  -- Scripts may answer in any format.
  if is_script then
    return string.format("%s %d bytes", title, input.len), false
  end
  return title .. ": " .. why, true
end

local function size_of(tvb, at)
  return tvb(at + 4, 2):le_uint()
end

local function is_preamble(tvb, at)
  return tvb(at, 1):uint() == PREAMBLE and tvb(at + 1, 1):uint() == PREAMBLE and tvb(at + 2, 1):uint() == PREAMBLE
end

-- Returns whether an intact frame begins at this position.
local function is_intact(tvb, at)
  local left = tvb:len() - at
  if left < OVERHEAD or not is_preamble(tvb, at) then
    return false
  end
  local size = size_of(tvb, at)
  if size > LONGEST or left < OVERHEAD + size then
    return false
  end
  return checksum(tvb(at, HEAD + size)) == tvb(at + HEAD + size, 2):le_uint()
end

-- Adds a whole frame to the tree and returns its text, which is marked if the checksum is wrong.
local function add_frame(tvb, at, size, is_request, tree)
  local range = tvb(at, OVERHEAD + size)
  local sum = range(HEAD + size, 2)
  local right = checksum(range(0, HEAD + size))
  local item = tree:add(binary, range)
  item:add(field.request, range(0, 3), is_request):set_generated()
  item:add(field.id, range(3, 1))
  item:add_le(field.size, range(4, 2))
  local payload = size > 0 and range(HEAD, size) or nil
  local holder = payload and item:add(field.payload, payload) or item
  local words, is_refused = describe(range(3, 1):uint(), payload, is_request, holder)
  item:add_le(field.checksum, sum)
  local is_right = sum:le_uint() == right
  item:add(field.checksum_right, sum, is_right):set_generated()
  if not is_right then
    item:add_proto_expert_info(problem.checksum, string.format("Wrong checksum, expected %02X %02X", right % 256, math.floor(right / 256)))
    words = "[wrong checksum] " .. words
  end
  if is_refused then
    item:add_proto_expert_info(problem.refused)
  end
  item:add(field.meaning, range, words):set_generated()
  item:set_text("WSG: " .. words)
  return words
end

local function is_to_gripper(pinfo, ports)
  for _, port in ipairs(ports) do
    if pinfo.dst_port == port then
      return true
    elseif pinfo.src_port == port then
      return false
    end
  end
  return pinfo.dst_port < pinfo.src_port
end

local function dissect_binary(tvb, pinfo, tree, is_request)
  local at, len = 0, tvb:len()
  local may_wait = pinfo.can_desegment > 0 and len == tvb:reported_len()
  local said, dropped_from = {}, nil
  local function drop(to, why)
    if dropped_from and dropped_from < to then
      local range = tvb(dropped_from, to - dropped_from)
      local words = string.format("[%d bytes dropped]", to - dropped_from)
      local item = tree:add(binary, range)
      item:add(field.dropped, range):add_proto_expert_info(why)
      item:set_text("WSG: " .. words)
      said[#said + 1] = words
    end
    dropped_from = nil
  end
  local function wait(missing)
    pinfo.desegment_offset = at
    pinfo.desegment_len = missing
  end
  while at < len do
    local left = len - at
    local head = 0
    while head < math.min(left, 3) and tvb(at + head, 1):uint() == PREAMBLE do
      head = head + 1
    end
    local is_beginning = head == math.min(left, 3)
    local size = is_beginning and left >= HEAD and size_of(tvb, at) or nil
    if is_beginning and not size and may_wait then
      drop(at, problem.dropped)
      wait(DESEGMENT_ONE_MORE_SEGMENT)
      break
    elseif not is_beginning or not size or size > LONGEST then
      -- Advance by one byte only, because a frame may begin inside a false preamble.
      dropped_from = dropped_from or at
      at = at + 1
      if at == len then
        drop(at, is_beginning and problem.incomplete or problem.dropped)
      end
    elseif left < OVERHEAD + size then
      drop(at, problem.dropped)
      if may_wait then
        wait(OVERHEAD + size - left)
        break
      end
      -- A datagram ends here, so the frame is truncated.
      dropped_from = at
      at = at + 1
      while at < len and not is_intact(tvb, at) do
        at = at + 1
      end
      drop(at, problem.incomplete)
    else
      drop(at, problem.dropped)
      local stop = at + OVERHEAD + size
      local words = add_frame(tvb, at, size, is_request, tree)
      said[#said + 1] = words
      if words:sub(1, 1) == "[" then
        -- Continue at an intact frame inside the false one, if any.
        for inside = at + 1, stop - 1 do
          if is_intact(tvb, inside) then
            stop = inside
            break
          end
        end
      end
      at = stop
    end
  end
  return table.concat(said, "; ")
end

-- GCL, the text protocol.
local gcl_field = {
  request = ProtoField.bool("gcl.request", "To the gripper"),
  line = ProtoField.string("gcl.line", "Line"),
  name = ProtoField.string("gcl.name", "Command"),
  kind = ProtoField.string("gcl.kind", "Kind"),
  status = ProtoField.uint16("gcl.status", "Status", base.DEC, status_names),
}
gcl.fields = { gcl_field.request, gcl_field.line, gcl_field.name, gcl_field.kind, gcl_field.status }
local gcl_unknown =
  ProtoExpert.new("gcl.unknown", "Name not listed in the manual", expert.group.PROTOCOL, expert.severity.WARN)
gcl.experts = { gcl_unknown }

local function add_line(range, text, is_request, tree)
  local item = tree:add(gcl, range)
  item:add(gcl_field.request, range, is_request):set_generated()
  item:add(gcl_field.line, range, text)
  local upper = text:upper()
  local answer, rest = upper:match("^(%a+)%s+(.*)$")
  local name = upper:match("^@?%s*([%a%d_]+)")
  if not is_request and (answer == "ACK" or answer == "FIN" or answer == "ERR") then
    name = rest:match("^([%a%d_?]+)") or "?"
    local code = answer == "ERR" and rest:match("^[^%s]+%s+(%d+)")
    if code and tonumber(code) < 0x10000 then
      item:add(gcl_field.status, range, tonumber(code))
      text = text .. " (" .. (STATUS[tonumber(code)] or "E_?") .. ")"
    end
  end
  if name then
    item:add(gcl_field.name, range, name):set_generated()
    local command = GCL_COMMANDS[name]
    if command then
      item:add(gcl_field.kind, range, command):set_generated()
    else
      item:add_proto_expert_info(gcl_unknown)
    end
  end
  item:set_text("GCL: " .. text)
  return text
end

local function dissect_gcl(tvb, pinfo, tree, is_request)
  local at, len = 0, tvb:len()
  local may_wait = pinfo.can_desegment > 0 and len == tvb:reported_len()
  local text = tvb(0, len):raw()
  local said = {}
  while at < len do
    local stop = text:find("[\r\n]", at + 1)
    if not stop and may_wait then
      pinfo.desegment_offset = at
      pinfo.desegment_len = DESEGMENT_ONE_MORE_SEGMENT
      break
    end
    stop = stop or len
    local line = text:sub(at + 1, stop):gsub("^%s+", ""):gsub("%s+$", "")
    if line ~= "" then
      said[#said + 1] = add_line(tvb(at, stop - at), line, is_request, tree)
    end
    at = stop
  end
  return table.concat(said, "; ")
end

local function is_text(tvb)
  local first = tvb(0, 1):uint()
  return first == 9 or first == 10 or first == 13 or (first >= 32 and first < 127)
end

local ports = { tcp = 1000, udp = 1500 }

function binary.dissector(tvb, pinfo, tree)
  if tvb:len() == 0 then
    return 0
  end
  local is_gcl = is_text(tvb)
  local dissect = is_gcl and dissect_gcl or dissect_binary
  pinfo.cols.protocol = is_gcl and "GCL" or "WSG"
  local is_request = is_to_gripper(pinfo, { ports.tcp, ports.udp })
  local words = dissect(tvb, pinfo, tree, is_request)
  if words ~= "" then
    pinfo.cols.info = (is_request and "-> " or "<- ") .. words
    pinfo.cols.info:fence()
  end
  return tvb:len()
end

-- Heuristic for other ports: accepts a conversation from its first intact frame.
local function heuristic(tvb, pinfo, tree)
  if not is_intact(tvb, 0) then
    return false
  end
  pinfo.conversation = binary
  binary.dissector(tvb, pinfo, tree)
  return true
end
binary:register_heuristic("tcp", heuristic)
binary:register_heuristic("udp", heuristic)

binary.prefs.tcp_port = Pref.uint("TCP port", ports.tcp, "TCP port of the gripper, for both protocols")
binary.prefs.udp_port = Pref.uint("UDP port", ports.udp, "UDP port of the gripper, for both protocols")

local function register()
  DissectorTable.get("tcp.port"):add(ports.tcp, binary)
  DissectorTable.get("udp.port"):add(ports.udp, binary)
end

function binary.prefs_changed()
  DissectorTable.get("tcp.port"):remove(ports.tcp, binary)
  DissectorTable.get("udp.port"):remove(ports.udp, binary)
  ports.tcp, ports.udp = binary.prefs.tcp_port, binary.prefs.udp_port
  register()
end

register()
