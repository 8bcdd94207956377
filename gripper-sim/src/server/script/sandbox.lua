-- Removes functions of Lua 5.1 that a script on the gripper must not have, and adds `require`. Runs once, before the script.
--
-- Everything is stored in locals, because a script may overwrite or hide (`setfenv`) any global.

local MAX_PATTERN_LEN, load_module, socket = ...
local error, loadstring, pcall, type, unpack = error, loadstring, pcall, type, unpack
local MAX_RESULTS = 7000
local byte, concat, find, gmatch, gsub, match =
    string.byte, table.concat, string.find, string.gmatch, string.gsub, string.match

-- Lua 5.1's check for too many results overflows. Compilers optimize it away, and the stack is overrun.
function _G.unpack(list, from, to)
    from, to = (from or 1) + 0, (to or #list) + 0
    if not (from >= -2 ^ 31 and to < 2 ^ 31 and to - from < MAX_RESULTS) then
        error("unpack: too many results", 2)
    end
    return unpack(list, from, to)
end

-- Access to any file, bytecode, and finalizers, which may run at any point.
dofile, loadfile, newproxy, string.dump = nil, nil, nil, nil

-- Raises an error at the position of the call in the script.
local function finish(ok, ...)
    if ok then return ... end
    error((...), 3)
end

-- Lua 5.1's match recurses once per item of the pattern without a limit. A long pattern would overflow the stack of the thread.
local function check(name, pattern)
    if type(pattern) == "string" and #pattern > MAX_PATTERN_LEN then
        error("string." .. name .. ": a pattern may have at most " .. MAX_PATTERN_LEN .. " bytes", 3)
    end
end

function string.find(text, pattern, from, plain)
    if not plain then check("find", pattern) end
    return finish(pcall(find, text, pattern, from, plain))
end

function string.match(text, pattern, from)
    check("match", pattern)
    return finish(pcall(match, text, pattern, from))
end

function string.gmatch(text, pattern)
    check("gmatch", pattern)
    return gmatch(text, pattern)
end
string.gfind = string.gmatch

function string.gsub(text, pattern, by, times)
    check("gsub", pattern)
    -- Errors of a function already contain their position.
    if type(by) == "function" then return gsub(text, pattern, by, times) end
    return finish(pcall(gsub, text, pattern, by, times))
end

-- Lua does not verify bytecode, which may read and write any memory.
function _G.loadstring(text, name)
    if byte(text, 1) == 27 then return nil, "a script is text; expected no bytecode" end
    return loadstring(text, name)
end
local load_text = _G.loadstring

function load(read, name)
    local pieces = {}
    while true do
        local ok, piece = pcall(read)
        if not ok then return nil, piece end
        if piece == nil or piece == "" then break end
        if type(piece) ~= "string" then return nil, "reader function must return a string" end
        pieces[#pieces + 1] = piece
    end
    return load_text(concat(pieces), name or "=(load)")
end

-- Modules that are loaded; `false` for one that is being loaded.
local modules = { socket = socket }

function require(name)
    local module = modules[name]
    if module == nil then
        local run, why = load_module(name)
        if not run then error(why, 2) end
        modules[name] = false
        local ok, result = pcall(run, name)
        module = ok and (result or true) or nil
        modules[name] = module
        if not ok then error(result, 0) end
    elseif module == false then
        error("require: " .. name .. " requires itself", 2)
    end
    return module
end
