-- Follows set-points that `wsg_protocol::driver::stream` sends, and reports the state in each answer.
-- Upload: docs/python.md. Message layout: docs/models.md.
--
-- A5h without payload: reports the state.
-- A5h with a byte 0: ends the stream and reports the state. The next set-point begins a new one.
-- A5h with position in mm, speed limit in mm/s, force limit in N: goes there. Numbers are IEEE 754 single, low byte first.
-- Answer: status, layout version, system state flags (4 bytes), position, speed, force, time in ms (4 bytes). A refusal is the
-- status alone.
--
-- Without a set-point for HOLD seconds, the fingers hold until the next one. FAST STOP, Stop and a pause of more than WATCHDOG
-- seconds end the stream with the fingers stopped. Each further set-point is then refused with the same status, until the
-- message with a byte 0.
local socket = require "socket"

local ID, VERSION = 0xA5, 1
-- Speed in mm/s per mm of remaining distance.
local GAIN = 15
-- The fingers stop within this distance of the set-point, in mm.
local DEAD_BAND = 0.1
local HOLD, WATCHDOG = 0.5, 1
-- Maximum time between two corrections of the speed, in s.
local PERIOD = 0.02
-- System state flags.
local REFERENCED, BLOCKED_MINUS, BLOCKED_PLUS, AXIS_STOPPED, FAST_STOP = 0x1, 0x4, 0x8, 0x40, 0x1000

local started = socket.gettime()
-- The set-point, its time of receipt, and whether a Stop since then would be detected.
local position, limit, received, is_armed
-- The last limit and speed, and the time at which they were set.
local force, speed, followed
-- The reason for the end of the last stream.
local ended

local function has(flags, flag)
  return flags % (2 * flag) >= flag
end

local function number(payload, at)
  return bton({ payload[at], payload[at + 1], payload[at + 2], payload[at + 3] })
end

local function word(value)
  local bytes = {}
  for at = 1, 4 do
    bytes[at] = value % 256
    value = math.floor(value / 256)
  end
  return bytes
end

local function finish(status)
  position, ended = nil, status
  mc.stop()
end

local function run(wanted)
  if wanted ~= speed then mc.speed(wanted) end
  speed = wanted
  -- A motion clears AXIS_STOPPED.
  is_armed = is_armed or wanted ~= 0
end

-- Sets the speed from the state. State calls are slow on a gripper, so once per message.
local function follow(flags, here)
  followed = socket.gettime()
  if not position then return end
  if has(flags, FAST_STOP) then return finish(E_ACCESS_DENIED) end
  if not has(flags, AXIS_STOPPED) then
    is_armed = true
  elseif is_armed then
    return finish(E_CMD_ABORTED)
  end
  local pause = followed - received
  if pause > WATCHDOG then return finish(E_TIMEOUT) end
  local way = position - here
  -- Fingers that push against a part must not release it.
  local is_held = pause > HOLD and not (has(flags, BLOCKED_MINUS) or has(flags, BLOCKED_PLUS))
  if math.abs(way) < DEAD_BAND or is_held then
    run(0)
  else
    run(math.max(-limit, math.min(limit, GAIN * way)))
  end
end

local function accept(payload, flags, here)
  if ended then return ended end
  if not has(flags, REFERENCED) then return E_NOT_INITIALIZED end
  local to, at_most, push = number(payload, 1), number(payload, 5), number(payload, 9)
  if not (to == to and at_most > 0 and push > 0) then return E_INVALID_PARAMETER end
  if not position then is_armed = not has(flags, AXIS_STOPPED) end
  if push ~= force then mc.force(push) end
  -- The speed is set again, because a block may have ended the motion.
  position, limit, force, speed, received = to, at_most, push, nil, socket.gettime()
  follow(flags, here)
  return ended or E_SUCCESS
end

local function serve()
  local _, payload = cmd.read()
  local flags, here = gripper.state(), mc.position()
  local status = E_CMD_FORMAT_ERROR
  if #payload == 0 then
    status = E_SUCCESS
  elseif #payload == 1 and payload[1] == 0 then
    if position then mc.stop() end
    status, position, ended = E_SUCCESS, nil, nil
  elseif #payload == 12 then
    status = accept(payload, flags, here)
  end
  if status ~= E_SUCCESS then return cmd.send(ID, etob(status)) end
  cmd.send(ID, etob(status), VERSION, word(flags), ntob(here), ntob(mc.speed()), ntob(mc.aforce()),
    word(math.floor((socket.gettime() - started) * 1000)))
end

local function turn()
  if cmd.available() > 0 then
    serve()
  elseif position and socket.gettime() - followed > PERIOD then
    follow(gripper.state(), mc.position())
  else
    sleep(1)
  end
end

cmd.register(ID)
while true do
  local ok, failure = pcall(turn)
  if not ok then
    pcall(mc.stop)
    pcall(cmd.send, ID, etob(E_CMD_FAILED))
    error(failure, 0)
  end
end
