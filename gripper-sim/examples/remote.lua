-- Measures and moves the gripper at the rate of a control loop.
--
-- B0h: measures. The payload is ignored.
-- B1h: moves and measures. The payload has 9 bytes (flag, width in mm, speed in mm/s) or 25 bytes (flag, width in mm,
--      speed in mm/s, kp in 1/s, kd, and the force limits in N for closing and opening). With 25 bytes, the fingers run
--      at the speed that controls this width until the next command. With flag 0, it only measures.
--
-- Both answer with status, lowest byte of the system state flags, width in mm, speed in mm/s, force in N and time in s.
-- Numbers are IEEE 754 singles, low byte first.
local socket = require "socket"

cmd.register(0xB0)
cmd.register(0xB1)

local started = socket.gettime()

local function number(payload, at)
  return bton({ payload[at], payload[at + 1], payload[at + 2], payload[at + 3] })
end

local function within(value, limit)
  return math.max(-limit, math.min(limit, value))
end

local function follow(payload)
  local width, speed = number(payload, 2), number(payload, 6)
  local kp, kd = number(payload, 10), number(payload, 14)
  local error = width - mc.position()
  mc.force(number(payload, error < 0 and 18 or 22))
  -- A speed of 0 stops the fingers.
  mc.speed(within(kp * error - kd * mc.speed(), speed))
end

local function move(payload)
  if payload[1] == 0 then return E_SUCCESS end
  if #payload == 25 then
    follow(payload)
    return E_SUCCESS
  end
  if #payload ~= 9 then return E_CMD_FORMAT_ERROR end
  if mc.busy() then mc.stop() end
  return mc.move(number(payload, 2), number(payload, 6))
end

local function serve()
  local id, payload = cmd.read()
  local status = E_SUCCESS
  if id == 0xB1 then
    local ok, result = pcall(move, payload)
    status = ok and result or E_INVALID_PARAMETER
    if not ok then print(result) end
  end
  cmd.send(id, etob(status), gripper.state() % 256, ntob(mc.position()), ntob(mc.speed()), ntob(mc.aforce()),
    ntob(socket.gettime() - started))
end

while true do
  local ok, failure = pcall(serve)
  if not ok then
    print(failure)
    sleep(100)
  end
end
